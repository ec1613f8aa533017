"""Sensor models: what the robot would measure, with rate, delay, noise and resolution."""
