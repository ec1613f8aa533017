"""Wind: constant, gusts, turbulence with a seed, the jet, and the apparent wind of a driving
car.
"""

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose
from pydrake.systems.analysis import Simulator

from aerodima.workbench.aero.sections import Jet
from aerodima.workbench.aero.wind import WindModel, WindSource
from aerodima.workbench.core.errors import ModelError
from tests.refusals import assert_refused
from tests.workbench.samples import sampled


def history(model, duration):
    """Wind sampled after every update (steps x 3), m/s."""
    times = (np.arange(int(duration / 0.01)) + 0.5) * 0.01
    return sampled(Simulator(WindSource(model)), times, "wind_velocity")


def test_a_gust_is_a_sine_about_the_mean():
    source = WindSource(WindModel(mean=(1.0, 2.0, 0.0), gust=(0.0, 3.0, 0.0), gust_frequency=0.5))
    context = source.CreateDefaultContext()
    for time, expected in ((0.0, 2.0), (0.5, 5.0), (1.0, 2.0), (1.5, -1.0)):
        context.SetTime(time)
        assert_allclose(
            source.GetOutputPort("wind_velocity").Eval(context), [1.0, expected, 0.0], atol=1e-12
        )
    context.SetTime(0.0)
    acceleration = source.GetOutputPort("wind_acceleration").Eval(context)
    assert_allclose(acceleration, [0.0, 3.0 * math.pi, 0.0], atol=1e-12)


def test_turbulence_has_the_given_spread_and_memory():
    """500 time constants: spread and memory are known to 1/sqrt(500) = 4.5 %; bounds allow three
    times that.
    """
    model = WindModel(turbulence=(1.0, 2.0, 0.0), time_constant=0.1, seed=3)
    rows = history(model, 50.0)
    assert np.std(rows[:, 0]) == pytest.approx(1.0, rel=0.15)
    assert np.std(rows[:, 1]) == pytest.approx(2.0, rel=0.15)
    assert np.all(rows[:, 2] == 0.0)
    lag = np.corrcoef(rows[:-10, 0], rows[10:, 0])[0, 1]
    assert lag == pytest.approx(math.exp(-1.0), abs=0.15)
    assert abs(np.corrcoef(rows[:, 0], rows[:, 1])[0, 1]) < 0.15


def test_the_tunnel_blows_downstream():
    """Towards -y, turned by psi about z (design section 4)."""
    jet = Jet.below_pivot((0, 0, 0), 0.265, psi=0.1)
    assert_allclose(
        WindModel.in_jet(jet, 10.0).mean, [10 * math.sin(0.1), -10 * math.cos(0.1), 0.0], rtol=1e-12
    )


@pytest.mark.parametrize(
    "change",
    [
        {"mean": (math.nan, 0.0, 0.0)},
        {"turbulence": (-1.0, 0.0, 0.0)},
        {"gust_frequency": 0.0},
        {"seed": -1},
    ],
    ids=str,
)
def test_bad_wind_is_refused(change):
    assert_refused(lambda: WindModel(**change), ModelError, *change)
