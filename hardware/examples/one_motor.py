"""Swings the tail's roll joint for three seconds: `python -m aerodima.hardware.examples.one_motor
PORTS WIRING`.
"""

import math
import sys

import numpy as np

from aerodima.hardware import CarCommand, connect, holding, run_cycles

if __name__ == "__main__":
    ports, wiring = sys.argv[1:]
    with holding(connect(ports, "auto_turn", wiring)) as car:
        start = car.reading.tail_state[1]
        for cycle in range(300):
            angle = start + 0.1 * math.sin(0.02 * math.pi * cycle)
            # The five numbers are position, speed, kp, kd and torque.
            command = CarCommand(tail_roll=np.array([angle, 0.0, 60.0, 5.0, 0.0]))
            run_cycles(car, command)
            print(
                f"{car.reading.tail_state[1]:+.3f} rad {car.reading.tail_torque[1]:+.2f} N m "
                f"{car.reading.fault_text}"
            )
