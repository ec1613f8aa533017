"""Byte and frame carriers of the car: CAN adapters, serial links.

No meaning of the bytes, no Drake.
"""
