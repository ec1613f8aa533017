"""Entry speeds of manoeuvres on the full car: climbs of many cars and tails, and a summary."""
