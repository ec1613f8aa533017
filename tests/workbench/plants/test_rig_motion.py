"""The fast pendulum moves and reacts as the Drake plant, and its rollouts converge."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from aerodima.workbench.config.scenario import RigScenario, load_rig_scenario
from aerodima.workbench.errors import ScenarioError, UserError
from aerodima.workbench.plants.joint_friction import smooth_friction
from aerodima.workbench.plants.rig import Rig
from aerodima.workbench.plants.rig_motion import RigMotion, logged_torque, no_torque

VARIANTS: list[tuple[str, dict[str, Any]]] = [
    ("flick", {}),
    ("flick", {"experiment": {"tail": 3, "axis": "minor", "wind_speed": 20.0}}),
    ("flick", {"aero": {"added_mass": 0.02}}),
    ("flick", {"aero": {"added_mass": -0.01}}),
    ("flick", {"tunnel": {"misalignment": 0.05, "psi3": -0.1}}),
    ("flick", {"aero": {"source": "constant", "sections": 3}}),
    ("bar", {}),
    ("robot", {}),
    ("robot", {"aero": {"source": "constant", "sections": 1}}),
]
TIME = np.linspace(0.0, 1.0, 1001)


def scenario(name: str, changes: dict[str, Any]) -> RigScenario:
    return load_rig_scenario(name).varied(**changes)


@pytest.mark.parametrize(("name", "changes"), VARIANTS)
def test_it_moves_and_reacts_as_the_plant(name: str, changes: dict[str, Any]) -> None:
    """The same physics written twice: to 1e-9, with room for the rounding of two different orders of summation."""
    rig, motion = Rig(scenario(name, changes)), RigMotion.of(scenario(name, changes))
    rng = np.random.default_rng(11)
    for _ in range(40):
        angle, rate, torque = rng.uniform(-1.7, 1.7), rng.uniform(-12, 12), rng.uniform(-5, 5)
        reaction = rig.reaction(angle, rate, torque)
        acceleration = motion.acceleration(angle, rate, torque)
        assert acceleration == pytest.approx(reaction.acceleration, rel=1e-9, abs=1e-9)
        (wrench,) = motion.wrenches(angle, rate, acceleration)
        np.testing.assert_allclose(wrench, reaction.wrench, rtol=1e-9, atol=1e-9)
        if motion.blades:
            np.testing.assert_allclose(motion.sections(angle, rate), rig.sections(angle, rate)[:, :2], atol=1e-9)


def test_rollout_keeps_the_energy_of_a_frictionless_bar() -> None:
    """Classical Runge-Kutta at 4 ms: the energy of a swing of 1 J stays to better than 1e-6 over a second."""
    motion = replace(RigMotion.of(scenario("bar", {})), friction=smooth_friction(0.0, 0.0, 10.0))
    angle, rate = motion.rollout(TIME, (1.5, 0.0), no_torque).T
    energy = 0.5 * motion.inertia * rate**2 - 0.313 * 9.81 * 0.1 * np.cos(angle)
    assert np.ptp(angle) > 2.9
    assert np.ptp(energy) < 1e-6


@pytest.mark.parametrize("name", ["flick", "bar", "robot"])
def test_rollout_converges_below_an_encoder_count(name: str) -> None:
    """The default step against an eighth of it; the forces have kinks at the jet's edge, so not to rounding."""
    motion = RigMotion.of(scenario(name, {}))
    coarse = motion.rollout(TIME, (1.2, 0.5), no_torque)
    fine = motion.rollout(TIME, (1.2, 0.5), no_torque, most_step=5e-4)
    assert np.max(np.abs(coarse - fine)[:, 0]) < 0.2 * 1.18e-4
    assert np.max(np.abs(coarse - fine)[:, 1]) < 1e-3


def test_times_between_the_steps_belong_to_the_same_motion() -> None:
    motion = RigMotion.of(scenario("bar", {}))
    angle, rate = motion.rollout(TIME, (1.5, 0.0), no_torque).T
    np.testing.assert_allclose(np.gradient(angle, TIME)[2:-2], rate[2:-2], atol=2e-3)
    few = motion.rollout(TIME[::100], (1.5, 0.0), no_torque)
    np.testing.assert_allclose(few, np.column_stack((angle, rate))[::100], atol=1e-6)


def test_logged_torque_is_linear_between_its_samples() -> None:
    torque = logged_torque(np.array([1.0, 1.5, 2.0]), np.array([0.0, 4.0, -2.0]))
    values = [torque(t, 0.0, 0.0) for t in (1.0, 1.25, 1.5, 1.75, 2.0)]
    assert values == pytest.approx([0.0, 2.0, 4.0, 1.0, -2.0])


def test_motor_torque_moves_it_downstream() -> None:
    motion = RigMotion.of(scenario("bar", {}))
    assert motion.rollout(TIME, (0.0, 0.0), lambda t, angle, rate: 0.2)[-1, 0] > 0.3


def test_added_mass_that_leaves_no_inertia_is_refused() -> None:
    motion = replace(RigMotion.of(scenario("flick", {})), added_mass=-0.033)
    with pytest.raises(UserError, match=r"added_mass: -0.033 kg per part; allowed on this rig: above -0.02\d+ kg"):
        motion.rollout(TIME, (1.0, 0.0), no_torque)


def test_a_motion_without_bounds_is_refused() -> None:
    motion = RigMotion.of(scenario("bar", {}))
    with pytest.raises(UserError, match="the motion has left all bounds"):
        motion.rollout(TIME, (0.0, 0.0), lambda t, angle, rate: 500.0)


def test_added_mass_on_a_tilted_tail_is_refused() -> None:
    with pytest.raises(ScenarioError, match=r"aero.added_mass: 0.02 kg; allowed: 0 kg with tunnel.misal"):
        scenario("flick", {"aero": {"added_mass": 0.02}, "tunnel": {"misalignment": 0.05}})
