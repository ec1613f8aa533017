"""Steering and tail as one programme: what a driver and a tail do together turns a car furthest on a given floor."""
