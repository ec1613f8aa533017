"""The simulated car behind real byte streams: a process of its own that speaks the side of the
car's devices.
"""
