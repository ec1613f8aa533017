"""The wired car: its devices behind one protocol, in three arrangements. No Drake."""
