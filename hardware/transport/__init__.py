"""Byte and frame carriers of the car: CAN adapters, serial links.

They know nothing of the meaning of the bytes, and need no Drake.
"""
