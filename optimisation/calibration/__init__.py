"""Cars that the published figures leave possible, what they predict, and what to measure next."""
