"""`aerodima models check`."""

import shutil

import pytest

from aerodima.workbench.car.car_model import car_sdf
from aerodima.workbench.cli.model_check import check_shipped_models, require_mass_where_drawn
from aerodima.workbench.core.errors import ModelError
from aerodima.workbench.core.resources import models_dir
from aerodima.workbench.scenario.scenario import load_scenario
from tests.commands import done
from tests.refusals import assert_named, assert_refused

LINK = """
<link name="{name}"><inertial><mass>{mass}</mass>
<inertia><ixx>0.1</ixx><iyy>0.1</iyy><izz>{izz}</izz></inertia></inertial></link>
"""
JOINT = """
<joint name="hinge" type="revolute"><parent>a</parent><child>b</child>
<axis><xyz>0 0 1</xyz><dynamics>{dynamics}</dynamics></axis></joint>
"""
URDF = """
<robot name="r"><link name="a"/><link name="b"><inertial><mass value="1"/>
<inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link>
<joint name="hinge" type="continuous"><parent link="a"/><child link="b"/><axis xyz="0 0 1"/>
<dynamics damping="0.1" {attribute}="2.5"/></joint></robot>
"""
MESH = '<{kind}><geometry><mesh filename="none.obj"/></geometry></{kind}>'


def sdf(dynamics="", mass=1.0, izz=0.1):
    links = LINK.format(name="a", mass=1.0, izz=0.1) + LINK.format(name="b", mass=mass, izz=izz)
    joint = JOINT.format(dynamics=dynamics)
    return f'<sdf version="1.9"><model name="m">{links}{joint}</model></sdf>'


def written(folder, text):
    path = folder / ("model.sdf" if "<sdf" in text else "model.urdf")
    path.write_text(text)
    return path


def test_everything_that_ships_passes():
    results = list(check_shipped_models())
    assert [problem for result in results for problem in result.problems] == []
    subjects = " ".join(result.subject for result in results)
    named = (
        "car.sdf: numbers equal",
        "tail.sdf: numbers equal",
        "parameters/car.yaml",
        "scenarios/turn_none.yaml",
        "parameters/hardware/motor_safety.yaml",
        "coefficients/robot_tail_line.yaml",
        "coefficients/half_cylinder.yaml",
    )
    assert_named(subjects, named)


def test_a_chassis_with_its_mass_above_its_drawn_parts_is_refused():
    high = car_sdf(load_scenario("turn_none", ["car.com_height=0.28"]))
    assert_refused(lambda: require_mass_where_drawn(high), ModelError, "chassis", "mm outside")


def test_broken_coefficients_and_hardware_parameters_are_found(tmp_path, monkeypatch):
    models = tmp_path / "models"
    shutil.copytree(models_dir(), models)
    for name, old, new in (
        ("coefficients/robot_tail_line.yaml", "cn_intercept: 1.58", "cn_intercept: -9.58"),
        (
            "parameters/hardware/motor_safety.yaml",
            "unit: degC, source: chosen",
            "unit: degC, source: hearsay",
        ),
    ):
        text = (models / name).read_text()
        assert old in text
        (models / name).write_text(text.replace(old, new))
    for module in ("aerodima.workbench.cli.model_check", "aerodima.workbench.core.yaml_files"):
        monkeypatch.setattr(f"{module}.models_dir", lambda: models)
    monkeypatch.setattr("aerodima.workbench.cli.model_check.nominal_models", list)
    problems = " ".join(problem for result in check_shipped_models() for problem in result.problems)
    assert "robot_tail_line.yaml: cn_slope" in problems
    assert "motor_safety.yaml: temperature_limit" in problems


def urdf(attribute, shape=""):
    return URDF.format(attribute=attribute).replace("</link>", f"{shape}</link>")


def test_good_model_of_a_user_passes(tmp_path):
    done("models", "check", written(tmp_path, sdf("<damping>0.1</damping>")))


@pytest.mark.parametrize(
    ("text", "named"),
    [
        (sdf("<friction>0.2</friction>"), ("joint 'hinge'", "friction")),
        (urdf("friction"), ("friction", "2.5")),
        (urdf("spring_stiffness"), ("spring_stiffness", "2.5")),
        (urdf("effort", MESH.format(kind="visual")), ("none.obj",)),
        (urdf("effort", MESH.format(kind="collision")), ("none.obj",)),
        # Triangle inequality: no body has izz above ixx + iyy.
        (sdf(izz=0.5), ("model.sdf",)),
        (sdf(mass=-1.0), ("model.sdf",)),
    ],
)
def test_a_wrong_model_fails_with_its_problem(call, tmp_path, text, named):
    """The verdict is no, exit status 1, with the problems on stderr."""
    result = call("models", "check", written(tmp_path, text))
    assert result.exit_code == 1, result.output
    assert_named(result.stderr, named)


def test_missing_and_foreign_files_are_named(refused, tmp_path, untouched):
    assert "nothing.sdf" in refused("models", "check", tmp_path / "nothing.sdf")
    assert ".sdf, .urdf" in refused("models", "check", untouched)


def test_tail_is_shown_saved_and_drawn(refused, tmp_path):
    saved = tmp_path / "tail.yaml"
    picture = tmp_path / "tail.png"
    shown = done("models", "tail", "--out", saved, "--out", picture)
    lines = [line.split() for line in shown.splitlines()]
    tail = load_scenario("turn_swing").tail
    area = f"{1e4 * tail.sail_length * tail.sail_width:.4g}"
    middle = f"{tail.length - 0.5 * tail.sail_length:.4g}"
    assert ["sail", "plate", area, "0", "0", middle, "5"] in lines
    assert ["mass_g", f"{1e3 * tail.mass:.4g}"] in lines
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert str(saved) in refused("models", "tail", "--out", saved)
    assert ".yaml" in refused("models", "tail", "--out", "tail.jpg")
    assert "other.yaml" in refused("models", "tail", "--file", tmp_path / "other.yaml")
