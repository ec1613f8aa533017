"""The wind-tunnel rigs: plant, pendulum model, station, sensors, controllers and runs."""
