"""What Drake systems of the workbench share: order of events, named state, noise, connections."""
