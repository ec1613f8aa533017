"""The simulated car behind real byte streams: a process of its own that speaks for the car's
devices.
"""
