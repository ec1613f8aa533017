"""A reduced car, many at once: what it finds in milliseconds says which candidates the full car
should drive.
"""
