"""Swings the tail's roll joint for three seconds: `python -m aerodima.hardware.examples.one_motor PORTS WIRING`."""

import math
import sys

import numpy as np

from aerodima.hardware.car.wiring import CarCommand
from aerodima.hardware.drive.held_car import held_car, turn

if __name__ == "__main__":
    with held_car("auto_turn", *sys.argv[1:]) as car:
        start = car.reading.tail_state[1]
        for cycle in range(300):
            angle = start + 0.1 * math.sin(0.02 * math.pi * cycle)
            command = CarCommand(tail_roll=np.array([angle, 0.0, 60.0, 5.0, 0.0]))  # position, speed, kp, kd, torque
            turn(car, command)
            print(
                f"{car.reading.tail_state[1]:+.3f} rad {car.reading.tail_torque[1]:+.2f} N m {car.reading.fault_text}"
            )
