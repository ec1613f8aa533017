"""A simulated station on its own, with constant inputs: what happens when nobody drives."""

import numpy as np
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import LeafSystem

from aerodima.workbench.car.car_station import make_car_station, simulated_car
from aerodima.workbench.car.ground_truth import CONTACT_TRUTH
from aerodima.workbench.core.sdf_model import SdfModel
from aerodima.workbench.scenario.signal_table import STATION_INPUTS, WHEELS


class CarStand:
    """The station of a scenario with every input fixed, zero unless given."""

    def __init__(self, scenario, **inputs):
        self.scenario = scenario
        self.station = make_car_station(scenario)
        self.simulator = Simulator(self.station)
        self.context = self.simulator.get_mutable_context()
        for name, fields in STATION_INPUTS.items():
            self.station.GetInputPort(name).FixValue(
                self.context, inputs.get(name, [0.0] * fields.size)
            )
        car = simulated_car(self.station)
        self.plant = car.plant
        self.car = car.car
        self.tail = car.tail
        self.plant_context = self.plant.GetMyMutableContextFromRoot(self.context)
        self.chassis = self.plant.GetBodyByName("chassis")

    def place(self, X_WB, velocity=(0.0, 0.0, 0.0)):
        """Puts the car somewhere, with its wheels still and every part moving at one velocity (m/s,
        W).
        """
        q, v = (
            get(self.plant_context).copy()
            for get in (self.plant.GetPositions, self.plant.GetVelocities)
        )
        start = self.chassis.floating_positions_start()
        q[start : start + 7] = [*X_WB.rotation().ToQuaternion().wxyz(), *X_WB.translation()]
        start = self.chassis.floating_velocities_start_in_v()
        v[start : start + 6] = [0.0, 0.0, 0.0, *velocity]
        self.plant.SetPositions(self.plant_context, q)
        self.plant.SetVelocities(self.plant_context, v)

    def advance(self, time):
        self.simulator.AdvanceTo(time)

    def output(self, port):
        return self.station.GetOutputPort(port).Eval(self.context)

    def com(self):
        return self.plant.CalcCenterOfMassPositionInWorld(self.plant_context)

    def com_velocity(self):
        return self.plant.CalcCenterOfMassTranslationalVelocityInWorld(self.plant_context)

    def angle(self, joint):
        return self.plant.GetJointByName(joint).get_angle(self.plant_context)

    def turn(self, joint, angle):
        self.plant.GetJointByName(joint).set_angle(self.plant_context, angle)

    def rate(self, joint):
        return self.plant.GetJointByName(joint).get_angular_rate(self.plant_context)

    def spin(self, joint, rate):
        self.plant.GetJointByName(joint).set_angular_rate(self.plant_context, rate)

    def suspension(self, wheel):
        """Compression of a suspension from nominal ride height, m."""
        return self.plant.GetJointByName(f"{wheel}_suspension").get_translation(self.plant_context)

    def wheel_height(self, wheel):
        """Height of the middle of a wheel, m."""
        body = self.plant.GetBodyByName(f"{wheel}_wheel")
        return body.EvalPoseInWorld(self.plant_context).translation()[2]

    def _at_wheels(self, what, unit):
        contact = CONTACT_TRUTH.read(self.output("contact_truth"))._asdict()
        return {
            wheel: np.array(
                [contact[f"wheel_{what}_{wheel}_{axis}_truth_{unit}"] for axis in "xyz"]
            )
            for wheel in WHEELS
        }

    def wheel_forces(self):
        """Force of the ground on each wheel in W, N."""
        return self._at_wheels("force", "n")

    def wheel_loads(self):
        """Vertical part of these forces, N."""
        return {wheel: force[2] for wheel, force in self.wheel_forces().items()}

    def wheel_contacts(self):
        """Contact point of each wheel in W, m."""
        return self._at_wheels("contact", "m")

    def contacts(self):
        """Point contacts of the last step."""
        results = self.plant.get_contact_results_output_port().Eval(self.plant_context)
        return [
            results.point_pair_contact_info(index)
            for index in range(results.num_point_pair_contacts())
        ]

    def shape_of(self, contact):
        """Name of the car's collision shape in a contact, such as `tyre` or `cage_0`."""
        inspector = simulated_car(self.station).scene_graph.model_inspector()
        pair = contact.point_pair()
        names = [inspector.GetName(geometry).split("::")[-1] for geometry in (pair.id_A, pair.id_B)]
        return next(name for name in names if name != "ground")


class Interface(LeafSystem):
    """Has ports of these sizes and does nothing; a port of size 0 is missing."""

    def __init__(self, inputs, outputs):
        super().__init__()
        self.set_name("interface")
        for name, size in inputs.items():
            if size:
                self.DeclareVectorInputPort(name, size)
        for name, size in outputs.items():
            if size:
                self.DeclareVectorOutputPort(name, size, lambda context, output: None)


def port_sizes(system):
    """Size by name of the inputs, and of the outputs."""
    inputs = [system.get_input_port(index) for index in range(system.num_input_ports())]
    outputs = [system.get_output_port(index) for index in range(system.num_output_ports())]
    return tuple({port.get_name(): port.size() for port in ports} for ports in (inputs, outputs))


def edited(model, old, new, path):
    """A model file with one piece of text replaced."""
    text = model.text()
    assert old in text
    path.write_text(text.replace(old, new, 1), encoding="utf-8")
    return SdfModel(path)
