"""The closed form of the sail's motion says what Drake's multibody plant says."""

import numpy as np
import pytest
from pydrake.multibody.tree import JacobianWrtVariable
from pydrake.systems.framework import DiagramBuilder

from aerodima.workbench.aero.sail import generalised_force, sail_motion
from aerodima.workbench.car.car_plant import add_car_plant
from aerodima.workbench.scenario.scenario import load_scenario

JOINTS = ("tail_pitch", "tail_roll", "tail_sail_turn")


@pytest.fixture(scope="module")
def plant():
    builder = DiagramBuilder()
    return add_car_plant(builder, load_scenario("turn_swing", ["tail.sail=free"])).plant


@pytest.mark.parametrize("seed", range(5))
def test_pose_velocity_and_forces_are_those_of_the_plant(plant, seed):
    rng = np.random.default_rng(seed)
    context = plant.CreateDefaultContext()
    chassis = plant.GetBodyByName("chassis")
    sail = plant.GetBodyByName("tail_sail")
    q = rng.normal(size=plant.num_positions())
    v = rng.normal(size=plant.num_velocities())
    start = chassis.floating_positions_start()
    q[start : start + 4] /= np.linalg.norm(q[start : start + 4])
    plant.SetPositions(context, q)
    plant.SetVelocities(context, v)
    joints = [plant.GetJointByName(name) for name in JOINTS]
    p_BoSo_B = plant.CalcRelativeTransform(
        context, chassis.body_frame(), sail.body_frame()
    ).translation()
    w = chassis.floating_velocities_start_in_v()
    motion = sail_motion(
        q[start : start + 4].tolist(),
        v[w : w + 6].tolist(),
        [q[joint.position_start()] for joint in joints],
        [v[joint.velocity_start()] for joint in joints],
        p_BoSo_B.tolist(),
    )
    np.testing.assert_allclose(
        motion.R_WS,
        plant.EvalBodyPoseInWorld(context, sail).rotation().matrix(),
        rtol=0.0,
        atol=1e-13,
    )
    V_WS = plant.EvalBodySpatialVelocityInWorld(context, sail)
    np.testing.assert_allclose(motion.w_WS, V_WS.rotational(), rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(motion.v_WSo, V_WS.translational(), rtol=0.0, atol=1e-12)

    force = rng.normal(size=3)
    moment = rng.normal(size=3)
    world = plant.world_frame()
    J = plant.CalcJacobianSpatialVelocity(
        context, JacobianWrtVariable.kV, sail.body_frame(), np.zeros(3), world, world
    )
    found = np.zeros(plant.num_velocities())
    found[[*range(w, w + 6), *(joint.velocity_start() for joint in joints)]] = generalised_force(
        motion, force, moment
    )
    np.testing.assert_allclose(found, J.T @ np.concatenate([moment, force]), rtol=0.0, atol=1e-12)
