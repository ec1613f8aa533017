"""The watched part of a diagram: plant or station, base, tail forces, and the columns they fill."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydrake.geometry import Meshcat, MeshcatVisualizer, SceneGraph
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import BodyIndex, RigidBody
from pydrake.systems.framework import (
    Context,
    Diagram,
    DiagramBuilder,
    EventStatus,
    LeafSystem,
    OutputPort,
)

from aerodima.workbench.aero.tail_force import TailForce, bodies_of, resolve_body
from aerodima.workbench.car.car_plant import own_instances
from aerodima.workbench.car.ground_truth import (
    BASE_COLUMNS,
    COM_COLUMNS,
    PlantTruth,
    air_columns,
    pose_columns,
    section_columns,
)
from aerodima.workbench.core.errors import ModelError
from aerodima.workbench.core.file_reading import Json
from aerodima.workbench.core.port_wiring import add_and_connect, vector_of
from aerodima.workbench.logs.recorder import Signals, output_ports, port_sources, signals_of
from aerodima.workbench.metrics.run_summary import TAILS
from aerodima.workbench.scenario.signal_table import (
    CAR_TRUTH,
    PLANT_POSITION_PREFIX,
    names_of,
    sensor_columns,
)
from aerodima.workbench.view.force_arrows import (
    AIR_COLOUR,
    SHOWN_LENGTH,
    DrawnArrow,
    point_on_axis,
)
from aerodima.workbench.view.logged_run import MIN_SIZE, SCENE
from aerodima.workbench.view.scene_shapes import plant_shapes, scene_bodies, shape_points
from aerodima.workbench.view.viewer import WORLD, area_around, draw_ground

_STATION_TRUTH = ("contact_truth", "wind_truth")
"""Ports of a simulated car's station that are recorded beside the motion."""
PICTURES_PER_SECOND = 32.0
"""Rate of the pictures, that of Drake's own visualizer, Hz."""
_FLOOR_MARGIN = 10.0
"""Margin of the floor about the starting place, m."""


@dataclass(frozen=True)
class WatchedPlant:
    """A plant in a diagram under construction, and the parts of it that are drawn.

    Attributes:
        plant: finalised plant.
        station: diagram that holds the plant; None where the builder itself does.
        state: output port of the plant's state [q; v].
        base: index of the body whose tilt, heading and speed count; None without one.
        tails: `TailForce` systems on bodies of the plant; those in a station are computed a second
            time.
        wind: output port of the wind that the tails feel; None in still air.
        scene: visible shapes of the plant, see `plant_shapes`.
        scene_graph: scene graph of this builder that the plant is registered with; None without
            one, or in a station.
        bodies: label and index of each body that has visible shapes.
    """

    plant: MultibodyPlant
    station: Diagram | None
    state: OutputPort
    base: BodyIndex | None
    tails: list[Any]
    wind: OutputPort | None
    scene: list[Json]
    scene_graph: SceneGraph | None
    bodies: dict[str, BodyIndex]

    @classmethod
    def find(
        cls, builder: DiagramBuilder, plant: MultibodyPlant | Diagram, base: RigidBody | str | None
    ) -> WatchedPlant:
        """Finds these parts in a builder; ModelError as for `observe` in `view.observed_run`."""
        if plant not in builder.GetSystems():
            raise ModelError(f"observe: '{plant.get_name()}' is not in this builder; add it first")
        inside: DiagramBuilder | Diagram = builder
        station = None
        if not isinstance(plant, MultibodyPlant):
            inside = station = plant
            plant = _plant_in(station)
        if not plant.is_finalized():
            raise ModelError(
                f"observe: plant '{plant.get_name()}' is not finalised; call plant.Finalize() first"
            )
        systems = inside.GetSystems()
        tails = [
            system for system in systems if isinstance(system, TailForce) and system.plant is plant
        ]
        scene_graph = next((system for system in systems if isinstance(system, SceneGraph)), None)
        scene = []
        if scene_graph is not None and plant.geometry_source_is_registered():
            scene = plant_shapes(plant, scene_graph)
        if station is None:
            state = plant.get_state_output_port()
            winds = [port_sources(builder, tail).get("wind_velocity") for tail in tails]
            wind = next(filter(None, winds), None)
        else:
            state = station.GetOutputPort("plant_state_truth")
            wind = output_ports(station).get("wind_truth")
            inputs = {"plant_state": state}
            if wind is not None:
                inputs["wind_velocity"] = wind
            # Computed a second time, where their ports can be read.
            tails = [
                add_and_connect(builder, tail.reporter(), tail.get_name(), **inputs)
                for tail in tails
            ]
            scene_graph = None
        base_index = None
        floating = list(plant.GetFloatingBaseBodies())
        if base is not None:
            base_index = resolve_body(plant, base, "observe").index()
        elif len(floating) == 1:
            base_index = floating[0]
        bodies = scene_bodies(plant, scene)
        return cls(plant, station, state, base_index, tails, wind, scene, scene_graph, bodies)

    def add_truth(self, builder: DiagramBuilder) -> PlantTruth:
        """Adds the system that computes what is recorded and drawn; ModelError if this plant is
        watched already.
        """
        name = f"{self.plant.get_name()}_truth"
        if builder.HasSubsystemNamed(name):
            raise ModelError(
                f"observe: plant '{self.plant.get_name()}' is observed already; once is enough"
            )
        truth = PlantTruth(self.plant, self.base, list(self.bodies.values()), self.tails)
        wrenches = {tail.get_name(): tail.GetOutputPort("wrench") for tail in self.tails}
        return add_and_connect(builder, truth, name, plant_state=self.state, **wrenches)

    def show(
        self, builder: DiagramBuilder, truth: PlantTruth, meshcat: Meshcat, air_scale: float
    ) -> None:
        """Adds camera, arrows, and the visualizer of the shapes unless there is one.

        Raises:
            ModelError: the plant has no visible shapes.
        """
        if not any(map(self.plant.GetVisualGeometriesForBody, bodies_of(self.plant))):
            raise ModelError(
                f"observe: plant '{self.plant.get_name()}' has no visible shapes for Meshcat; make "
                "it with AddMultibodyPlantSceneGraph and parse the model after that"
            )
        seen = any(isinstance(system, MeshcatVisualizer) for system in builder.GetSystems())
        if self.scene_graph is not None and not seen:
            MeshcatVisualizer.AddToBuilder(builder, self.scene_graph, meshcat)
        names = [tail.get_name() for tail in self.tails]
        reach = dict.fromkeys(self.bodies, 0.0)
        for entry in self.scene:
            if entry["body"] in reach:
                distances = np.linalg.norm(shape_points(entry), axis=1)
                reach[entry["body"]] = max(reach[entry["body"]], float(distances.max()))
        live = LiveScene(meshcat, names, [*reach.values()], air_scale)
        sources = output_ports(truth).items()
        inputs = {port: source for port, source in sources if live.HasInputPort(port)}
        add_and_connect(builder, live, "live_scene", **inputs)

    def signals(self, truth: PlantTruth) -> Signals:
        """Lists the recorded ports with the names of their columns."""
        plant = self.plant
        names = [f"{PLANT_POSITION_PREFIX}{position}" for position in plant.GetPositionNames()]
        names += [f"plant_velocity_{velocity}" for velocity in plant.GetVelocityNames()]
        extra_states = plant.num_multibody_states() - len(names)
        names += [f"plant_state_{index}" for index in range(extra_states)]
        poses = [column for label in self.bodies for column in pose_columns(label)]
        computed = {"base": list(BASE_COLUMNS), "com": list(COM_COLUMNS), "poses": poses}
        ports = output_ports(truth)
        signals: Signals = []
        if names:
            signals = [(self.state, names)]
        signals += [(ports[name], columns) for name, columns in computed.items() if name in ports]
        for tail in self.tails:
            name = tail.get_name()
            number = tail.layout.number
            validity = [f"{name}_section_{index}_validity" for index in range(number)]
            signals += [
                (ports[f"{name}_air"], air_columns(name)),
                (tail.GetOutputPort("sections"), section_columns(name, number)),
                (tail.GetOutputPort("validity"), validity),
            ]
        if self.station is not None:
            columns = ", ".join(names_of(sensor_columns())[1:])  # the log has the time
            warnings.warn(
                "observe: the log has no columns of sensors and commands, since settings= is no "
                f"Scenario; it is that of any plant and leaves out: {columns}",
                stacklevel=3,
            )
            table = {name: CAR_TRUTH[name] for name in _STATION_TRUTH}
            signals += signals_of(table, output_ports(self.station))
        elif self.wind is not None:
            signals.append((self.wind, names_of(CAR_TRUTH["wind_truth"])))
        return signals

    def facts(self) -> Json:
        """Collects what goes into `extra` of the log."""
        plant = self.plant
        mass = plant.CalcTotalMass(plant.CreateDefaultContext(), own_instances(plant))
        tails = [{"name": tail.get_name(), "body": tail.body.name()} for tail in self.tails]
        base = None
        if self.base is not None:
            base = plant.get_body(self.base).name()
        return {SCENE: self.scene, TAILS: tails, "base": base, "total_mass_kg": mass}


def _plant_in(station: Diagram) -> MultibodyPlant:
    plant: Any = None
    if station.HasSubsystemNamed("plant"):
        plant = station.GetSubsystemByName("plant")
    if plant is None or not station.HasOutputPort("plant_state_truth"):
        raise ModelError(
            f"observe: '{station.get_name()}' has no plant to be watched; must be a "
            "MultibodyPlant of this builder, "
            "or a simulated station, which has a subsystem 'plant' and a port 'plant_state_truth'"
        )
    return plant


class LiveScene(LeafSystem):
    """Moves the world under the camera as the robot moves, and the arrows of the air.

    Input ports:
        com (6): position, m, and velocity, m/s, of the centre of mass in W.
        poses (7 n): poses of the bodies that are drawn, see `PlantTruth`.
        <name of a tail force>_air (12): force N, moment about Wo N m, root and tip m of its
        sections, W axes.

    Args:
        meshcat: Meshcat that shows the robot.
        tails: names of the tail forces.
        reach: largest distance of a shape from the origin of its body, m, one per body of `poses`.
        air_scale: length of an arrow, m per N.
    """

    def __init__(
        self, meshcat: Meshcat, tails: Sequence[str], reach: Sequence[float], air_scale: float
    ) -> None:
        super().__init__()
        self._meshcat = meshcat
        self._reach = np.asarray(reach)
        self._air_scale = air_scale
        self._com = self.DeclareVectorInputPort("com", 6)
        self._poses = None
        if len(reach):
            self._poses = self.DeclareVectorInputPort("poses", 7 * len(reach))
        self._tails = []
        for name in tails:
            arrow = DrawnArrow(meshcat, f"air_on_{name}", AIR_COLOUR)
            self._tails.append((arrow, self.DeclareVectorInputPort(f"{name}_air", 12)))
        self.DeclareInitializationPublishEvent(self._place)
        self.DeclarePeriodicPublishEvent(1.0 / PICTURES_PER_SECOND, 0.0, self._show)

    def _show(self, context: Context) -> EventStatus:
        com = vector_of(self._com, context)[:3]
        self._meshcat.SetTransform(WORLD, RigidTransform(-com * [1.0, 1.0, 0.0]))
        for arrow, port in self._tails:
            parts = np.split(vector_of(port, context), 4)
            force, moment, root, tip = (part[None, :] for part in parts)
            length = self._air_scale * force[0]
            shown = bool(np.linalg.norm(length) > SHOWN_LENGTH)
            self._meshcat.SetProperty(arrow.path, "visible", shown)
            if shown:
                arrow.move(self._meshcat, point_on_axis(force, moment, root, tip)[0], length)
        return EventStatus.Succeeded()

    def _place(self, context: Context) -> EventStatus:
        """Puts the camera where all of the robot is seen, and a floor below it unless it hangs
        below z = 0.
        """
        com = vector_of(self._com, context)[:3]
        size = MIN_SIZE
        if self._poses is not None:
            places = vector_of(self._poses, context).reshape(-1, 7)[:, 4:]
            distances = np.linalg.norm(places - com, axis=1) + self._reach
            size = max(size, float(np.max(distances)))
        target = np.array([0.0, 0.0, com[2]])
        self._meshcat.SetCameraPose(target + size * np.array([1.4, -2.9, 0.9]), target)
        if com[2] >= 0.0:
            draw_ground(self._meshcat, area_around(com[None, :], _FLOOR_MARGIN))
        return EventStatus.Succeeded()
