"""The published swing, the player, feedback laws, drivers and paths, and their Drake systems."""
