"""Every tail controller on the same turns and the same possible cars."""
