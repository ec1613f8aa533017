"""Checks of everything in `models/`: loads, is physical, names its sources, agrees with itself."""

import xml.etree.ElementTree as ElementTree
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path

import numpy as np
from pydrake.geometry import SceneGraph
from pydrake.multibody.plant import MultibodyPlant
from scipy.spatial import ConvexHull

from aerodima.workbench.aero.coefficient_files import embedded_sets, load_coefficients
from aerodima.workbench.car.car_model import CAR_SDF, car_sdf
from aerodima.workbench.car.car_plant import strict_parser
from aerodima.workbench.car.tail_plant import tail_sdf
from aerodima.workbench.core.errors import ModelError, UserError
from aerodima.workbench.core.resources import models_dir
from aerodima.workbench.core.sdf_model import SdfModel
from aerodima.workbench.rig.rig_model import cheetah_rig_sdf, robot_rig_sdf
from aerodima.workbench.scenario.rig_scenario import RigScenario, rig_scenario_from_dict
from aerodima.workbench.scenario.scenario import Scenario, scenario_from_dict
from aerodima.workbench.scenario.scenario_file import load_parameter_file
from aerodima.workbench.scenario.swing_file import read_swing

IGNORED_BY_DRAKE = {
    "sdf": {
        "axis/dynamics/friction": "joint friction",
        "axis2/dynamics/friction": "joint friction",
    },
    "urdf": {
        "dynamics@friction": "joint friction",
        "dynamics@spring_stiffness": "joint spring",
        "dynamics@spring_reference": "joint spring",
    },
}
"""Elements (or `element@attribute`) below a joint that Drake skips, even when it parses strictly,
with their meaning."""
SOURCED = "unit and source of every number"


@dataclass(frozen=True)
class CheckResult:
    """One check: its subject, and the problems found (none if it passed)."""

    subject: str
    problems: tuple[str, ...]


def check_shipped_models() -> Iterator[CheckResult]:
    """Run every check of `models/`, one result each, in the order in which a reader would ask."""
    root = models_dir()
    for path in sorted([*root.rglob("*.sdf"), *root.rglob("*.urdf")]):
        yield from check_model_file(path)
    for scenario in (Scenario, RigScenario):
        for section in scenario.sections():
            if section not in scenario.shared_with_car:
                name = f"{scenario.parameter_folder}/{section}.yaml"
                yield _attempt(f"{name}: {SOURCED}", scenario.parameters, section)
    for path in sorted((root / "parameters" / "hardware").glob("*.yaml")):
        yield _attempt(f"parameters/hardware/{path.name}: {SOURCED}", load_parameter_file, path)
    for name in embedded_sets():
        yield _attempt(f"coefficients/{name}.yaml: reads and makes a law", _make_law, name)
    for model in nominal_models():
        name = str(model.path.relative_to(root))
        yield CheckResult(f"{name}: numbers equal the parameters", tuple(sdf_differences(model)))
        if name == CAR_SDF:
            subject = f"{name}: chassis' own centre of mass inside its drawn parts"
            yield _attempt(subject, require_mass_where_drawn, model)
    for scenario in (Scenario, RigScenario):
        for name in scenario.names():
            yield _attempt(f"{scenario.folder}/{name}.yaml: resolves", scenario.load, name)
    for path in sorted((root / "swings").glob("*.yaml")):
        yield _attempt(f"swings/{path.name}: reads", read_swing, path)


def check_model_file(path: Path) -> Iterator[CheckResult]:
    """Check one SDF or URDF file: no ignored attribute, loads strictly, every inertia physical."""
    name = str(path).removeprefix(f"{models_dir()}/")
    yield _attempt(f"{name}: nothing that Drake would ignore", refuse_ignored_attributes, path)
    yield _attempt(f"{name}: loads, inertias physical", load_strictly, path)


def refuse_ignored_attributes(path: Path) -> None:
    """Raise ModelError for joint friction, or a URDF joint spring, that Drake drops silently."""
    kind = path.suffix.lower().lstrip(".")
    if kind not in IGNORED_BY_DRAKE:
        raise ModelError(f"{path}: ending {path.suffix!r} must be .sdf or .urdf")
    try:
        root = ElementTree.parse(path).getroot()
    except (ElementTree.ParseError, OSError) as error:
        raise ModelError(f"{path}: cannot be read as XML: {error}") from None
    for joint in root.iter("joint"):
        for place, meaning in IGNORED_BY_DRAKE[kind].items():
            element_path, _, attribute = place.partition("@")
            element = joint.find(element_path)
            if element is None:
                continue
            value = element.get(attribute) if attribute else element.text
            if value is not None and value.strip() not in ("", "0", "0.0"):
                raise ModelError(
                    f"{path}: joint {joint.get('name')!r}: {place} = {value} is ignored by Drake; "
                    f"remove it and model the {meaning} as a system"
                )


def load_strictly(path: Path) -> None:
    """Parse a file into an empty plant with geometry; raises ModelError when Drake warns, fails,
    misses a mesh, or an inertia is not physical.
    """
    plant = MultibodyPlant(0.001)
    scene = SceneGraph()
    plant.RegisterAsSourceForSceneGraph(scene)
    try:
        instances = strict_parser(plant).AddModels(str(path))
        plant.Finalize()
    except RuntimeError as error:
        raise ModelError(f"{path}: does not load in Drake: {error}") from None
    context = plant.CreateDefaultContext()
    for instance in instances:
        for index in plant.GetBodyIndices(instance):
            body = plant.get_body(index)
            inertia = body.CalcSpatialInertiaInBodyFrame(context)
            if not (body.get_mass(context) > 0 and inertia.IsPhysicallyValid()):
                raise ModelError(
                    f"{path}: link {body.name()!r}: mass {body.get_mass(context)} kg or inertia "
                    "is not physical"
                )


def require_mass_where_drawn(car: SdfModel) -> None:
    """Raise ModelError if the chassis' own centre of mass lies outside the hull of its visuals."""
    hull = ConvexHull(car.drawn_corners("chassis"))
    com = car.inertial("chassis").com
    beyond = float(np.max(hull.equations[:, :3] @ com + hull.equations[:, 3]))
    if beyond > 0.0:
        x, _, z = com
        raise ModelError(
            f"{car.path}: chassis: its own centre of mass at x = {x:.3g} m, z = {z:.3g} m lies "
            f"{1e3 * beyond:.0f} mm outside its drawn parts"
        )


def sdf_differences(nominal: SdfModel) -> list[str]:
    """List the lines in which a file differs from the model with the parameters' numbers."""
    lines = zip_longest(
        SdfModel(nominal.path).text().splitlines(), nominal.text().splitlines(), fillvalue=""
    )
    return [
        f"line {number}: {here.strip()} in the file, {there.strip()} from the parameters"
        for number, (here, there) in enumerate(lines, 1)
        if here != there
    ]


def update_model_files() -> list[Path]:
    """Write the numbers of `models/parameters` into the SDF files; returns the files."""
    models = nominal_models()
    for model in models:
        model.path.write_text(model.text(), encoding="utf-8")
    return [model.path for model in models]


def nominal_models() -> list[SdfModel]:
    """Make the car, its tail arm and the two rigs with the numbers of `models/parameters`."""
    scenario = scenario_from_dict({})
    rig = rig_scenario_from_dict({})
    return [
        car_sdf(scenario),
        tail_sdf(scenario.tail, scenario.tail_motor, scenario.car),
        cheetah_rig_sdf(rig),
        robot_rig_sdf(rig),
    ]


def _make_law(coefficients: str) -> None:
    load_coefficients(coefficients).law()


def _attempt(subject: str, check: Callable[..., object], *arguments: object) -> CheckResult:
    try:
        check(*arguments)
    except UserError as error:
        return CheckResult(subject, (str(error),))
    return CheckResult(subject, ())
