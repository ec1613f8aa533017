"""A process of its own that switches the tail motors off when the drive process dies or hangs; the record of its test.

The real motors hold their last command for ever (design section 14). In the wiring `teensy_bridge` the firmware of the
Teensy watches; in `direct_can` this process does. It holds its own handle on the adapter from the start: a second
file descriptor on the terminal of a slcan adapter, a second socket of socketcan or socketcand. Nothing has to be opened
when the drive process is dead, and no frame of the loop takes a longer way through another process.
"""
