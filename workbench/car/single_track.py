"""The car as parameters of the single-track models of f1tenth_gym and CommonRoad.

The lateral force of a tyre in those models is mu C_S times its load per rad of slip angle. So is
ours at small slip angles, with C_S = 1 / tan(`car.tyre_slip_angle`) on both axles
(`stiction_tolerance`).
Mass, centre of mass and yaw inertia are those of the whole plant, the tail at rest included.
"""

import math

from pydrake.systems.framework import DiagramBuilder

from aerodima.workbench.car.car_plant import add_car_plant
from aerodima.workbench.car.laws import steady_speed
from aerodima.workbench.core.errors import ModelError
from aerodima.workbench.core.file_reading import Json
from aerodima.workbench.scenario.scenario import Scenario

COMMONROAD = {
    "vehicle": {
        "l": "length",
        "w": "width",
        "m": "m",
        "a": "lf",
        "b": "lr",
        "I_z": "I",
        "h_s": "h",
        "h_cg": "h",
    },
    "steering": {"min": "s_min", "max": "s_max", "v_min": "sv_min", "v_max": "sv_max"},
    "longitudinal": {name: name for name in ("a_max", "v_min", "v_max", "v_switch")},
}
"""Names of f1tenth_gym by section of CommonRoad ("vehicle": outside of sections) and name there."""


def gym_parameters(scenario: Scenario) -> dict[str, float]:
    """Compute the vehicle parameters of f1tenth_gym, in its names and in SI units.

    The car has no number for three of them: `length` is that over the tyres, `v_switch` equals
    `v_max`, since the torque of the drive does not fall with speed, and `v_min` is `-v_max`.

    Raises:
        ModelError: the tyres are rigid, or there is no such car.
    """
    car = scenario.car
    drive = scenario.drive
    servo = scenario.servo
    if car.tyre_slip_angle == 0.0:
        raise ModelError("car.tyre_slip_angle: 0 rad must be > 0 for a cornering stiffness")
    built = add_car_plant(DiagramBuilder(), scenario)
    plant = built.plant
    bodies = [body for instance in built.instances for body in plant.GetBodyIndices(instance)]
    M_VWo_W = plant.CalcSpatialInertia(plant.CreateDefaultContext(), plant.world_frame(), bodies)
    I_VVcm_W = M_VWo_W.Shift(M_VWo_W.get_com()).CalcRotationalInertia()
    lr, _, height = M_VWo_W.get_com().tolist()
    mass = M_VWo_W.get_mass()
    stiffness = 1.0 / math.tan(car.tyre_slip_angle)
    speed = steady_speed(1.0, drive)
    return {
        "mu": car.tyre_friction,
        "C_Sf": stiffness,
        "C_Sr": stiffness,
        "lf": car.wheelbase - lr,
        "lr": lr,
        "h": height,
        "m": mass,
        "I": float(I_VVcm_W.get_moments()[2]),
        "s_min": -servo.limit,
        "s_max": servo.limit,
        "sv_min": -servo.rate,
        "sv_max": servo.rate,
        "v_switch": speed,
        "a_max": drive.torque_limit / (car.tyre_radius * mass),
        "v_min": -speed,
        "v_max": speed,
        "width": car.track + car.tyre_width,
        "length": car.wheelbase + 2.0 * car.tyre_radius,
    }


def commonroad_parameters(scenario: Scenario) -> Json:
    """Compute what CommonRoad's single-track models read from its `parameters_vehicle*.yaml`.

    Its stiffness is that of the tyre, `p_ky1` = -mu C_S.

    Raises:
        ModelError: as `gym_parameters`.
    """
    gym = gym_parameters(scenario)
    sections: Json = {"tire": {"p_dy1": gym["mu"], "p_ky1": -gym["mu"] * gym["C_Sf"]}}
    for section, names in COMMONROAD.items():
        sections[section] = {name: gym[theirs] for name, theirs in names.items()}
    return sections.pop("vehicle") | sections
