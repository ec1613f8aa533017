"""What a system shows over time."""

import numpy as np


def sampled(simulator, times, *ports):
    """Values of some ports of the simulated system, side by side; a row per time."""
    system = simulator.get_system()
    rows = []
    for time in times:
        simulator.AdvanceTo(time)
        context = simulator.get_context()
        rows.append(np.concatenate([system.GetOutputPort(port).Eval(context) for port in ports]))
    return np.array(rows)
