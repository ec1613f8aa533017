"""A car whose steps are compiled with numba moves as the interpreted one, through whole runs."""

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

from aerodima.workbench.config.scenario import load_scenario
from aerodima.workbench.logs.schema import software_versions
from aerodima.workbench.simulate.car_run import assemble
from aerodima.workbench.stations import compiled_step

numba = pytest.importorskip("numba", reason="needs the extra `compiled`")

RUNS = {
    "no tail, flips, parallel linkage": ("turn_none", ["manoeuvre.speed=3.61", "servo.linkage=parallel"]),
    "published swing": ("turn_swing", []),
    "smaller sail to the right, in wind": ("turn_designed", ["manoeuvre.direction=right", "wind.mean_y=2.0"]),
    "free sail, of which one line is compiled": ("turn_swing", ["tail.sail=free", "tail.coefficients=robot_tail_line"]),
}


def states(scenario):
    """Every discrete state of the diagram at 50 Hz (times, n)."""
    car = assemble(scenario, systems="fused")
    simulator, rows = Simulator(car.builder.Build()), []
    for time in np.arange(0.0, 2.8, 0.02):
        simulator.AdvanceTo(time)
        values = simulator.get_context().get_discrete_state()
        rows.append(np.concatenate([values.value(group) for group in range(values.num_groups())]))
    return np.array(rows)


def switch_on(monkeypatch):
    monkeypatch.setenv("NUMBA_DISABLE_JIT", "0")
    monkeypatch.setattr(numba.config, "DISABLE_JIT", 0)


@pytest.mark.parametrize("case", RUNS)
def test_a_run_is_the_same_to_rounding(case, monkeypatch):
    name, settings = RUNS[case]
    scenario = load_scenario(name, settings)
    monkeypatch.setattr(compiled_step, "_known", {})
    interpreted = states(scenario)
    assert not compiled_step._known
    switch_on(monkeypatch)
    compiled = states(scenario)
    (function,) = compiled_step._known.values()
    assert function.signatures
    assert np.nanmax(np.abs(interpreted[-1] - interpreted[0])) > 1.0
    np.testing.assert_allclose(compiled, interpreted, rtol=0.0, atol=1e-9)


def test_compiled_code_is_told_once_and_kept_for_the_sources_it_comes_from(monkeypatch, capfd, tmp_path):
    scenario = load_scenario("turn_none")
    switch_on(monkeypatch)
    monkeypatch.setattr(compiled_step, "FOLDER", tmp_path)
    for told in (True, False):
        monkeypatch.setattr(compiled_step, "_known", {})
        Simulator(assemble(scenario, systems="fused").builder.Build()).AdvanceTo(0.01)
        assert ("compiling what drives the plant" in capfd.readouterr().err) is told
    (digest,) = tmp_path.iterdir()
    assert [*digest.rglob("*.nbi")]


def test_a_log_says_which_numba_compiled_its_steps(monkeypatch):
    assert "numba" not in software_versions()
    switch_on(monkeypatch)
    assert software_versions()["numba"] == numba.__version__
