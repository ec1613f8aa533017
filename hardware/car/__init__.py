"""The wired car: its devices behind one class, in two wirings. Driving it needs no Drake."""
