"""A car whose steps are compiled with numba moves as the interpreted one, through whole runs."""

import sys

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

from aerodima.workbench.aero.plates import Plates
from aerodima.workbench.config.scenario import load_scenario
from aerodima.workbench.errors import UserError
from aerodima.workbench.logs.schema import software_versions
from aerodima.workbench.plants.tail import ArmInertia
from aerodima.workbench.simulate.car_run import assemble
from aerodima.workbench.stations import compiled_step, step_drives

numba = pytest.importorskip("numba", reason="needs the extra `compiled`")

RUNS = {
    "no tail, flips, parallel linkage": ("turn_none", ["manoeuvre.speed=3.61", "servo.linkage=parallel"]),
    "published swing": ("turn_swing", []),
    "designed tail to the right, in wind": ("turn_designed", ["manoeuvre.direction=right", "wind.mean_y=2.0"]),
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


def test_compiled_code_is_kept_for_the_sources_it_comes_from_where_that_can_be(monkeypatch, capfd, tmp_path):
    (tmp_path / "file").touch()  # of a package that cannot be written
    monkeypatch.setattr(compiled_step, "PLACES", (tmp_path / "file", tmp_path / "home"))
    switch_on(monkeypatch)

    def told():
        monkeypatch.setattr(compiled_step, "_known", {})
        Simulator(assemble(load_scenario("turn_none"), systems="fused").builder.Build()).AdvanceTo(0.01)
        return "compiling what drives the plant" in capfd.readouterr().err

    assert [told(), told()] == [True, False]
    monkeypatch.setattr(
        compiled_step, "_CALLED", (*compiled_step._CALLED, another_source)
    )  # as if a source had changed
    assert told()
    assert len([*(tmp_path / "home").iterdir()]) == 2
    monkeypatch.setattr(compiled_step, "PLACES", ())
    assert [told(), told()] == [True, True]


def another_source(value):
    return value


class Different(dict):
    """Numbers that are all different, by what asks for them."""

    def __missing__(self, key):
        self[key] = 1.5 + len(self)
        return self[key]


def filled(kind, numbers, **given):
    return kind(**{name: given.get(name, numbers[kind.__name__, name]) for name in kind._fields})


def test_numbers_come_out_of_the_array_where_they_went_in():
    n = Different()
    car = filled(
        step_drives.CarNumbers, n, drive=filled(step_drives.DriveNumbers, n, governor=True),
        linkage=filled(step_drives.LinkageNumbers, n, linkage="ackermann"),
    )  # fmt: skip
    axes = {name: tuple(n[name, k] for k in range(3)) for name in ("axis_B", "normal_B", "p_BoRo_B", "p_BoSo_B")}
    strip = filled(step_drives.Strip, n, distances=(0.1, 0.2), areas=(0.3, 0.4), plates=filled(Plates, n), **axes)
    tail = filled(
        step_drives.TailNumbers, n, motor=filled(step_drives.MotorNumbers, n), arm=filled(ArmInertia, n), windy=True,
        line=(n["line", 0], n["line", 1]), strips=(strip,), p_BoSo_B=axes["p_BoSo_B"],
    )  # fmt: skip
    packed = compiled_step._packed(car, tail)
    assert compiled_step._car(packed[0]) == car
    assert compiled_step._tail(*packed[1:]) == tail
    assert compiled_step._car(
        compiled_step._packed(car._replace(drive=car.drive._replace(governor=False)), None)[0]
    ) == (car._replace(drive=car.drive._replace(governor=False)))


def test_numba_that_cannot_be_imported_is_one_clear_error(monkeypatch):
    switch_on(monkeypatch)
    monkeypatch.setattr(compiled_step, "_known", {})
    monkeypatch.setitem(sys.modules, "numba", None)
    with pytest.raises(UserError, match=r"numba \d.*; allowed: a version that can be imported, or NUMBA_DISABLE_JIT=1"):
        assemble(load_scenario("turn_none"), systems="fused")


def test_a_log_says_which_numba_compiled_its_steps(monkeypatch):
    assert "numba" not in software_versions()
    switch_on(monkeypatch)
    assert software_versions()["numba"] == numba.__version__
