"""Worth of a tail in a swerve: aims, candidates, their steering, and tables."""
