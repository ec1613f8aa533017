"""What a tail is worth: aims of a swerve, candidates, their steering, tables."""
