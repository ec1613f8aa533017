"""Car and rig behind their ports, simulated or real, with what they record of the truth."""
