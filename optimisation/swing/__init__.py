"""Tail swings: bounds, swing files and their verification; comparison and training of laws."""
