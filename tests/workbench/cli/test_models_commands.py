"""`aerodima models check`."""

import shutil

import pytest

from aerodima.workbench.cli.model_check import check_shipped_models
from aerodima.workbench.core.resources import models_dir

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


def sdf(tmp_path, dynamics="", mass=1.0, izz=0.1):
    links = LINK.format(name="a", mass=1.0, izz=0.1) + LINK.format(name="b", mass=mass, izz=izz)
    path = tmp_path / "model.sdf"
    path.write_text(
        f'<sdf version="1.9"><model name="m">{links}{JOINT.format(dynamics=dynamics)}</model></sdf>'
    )
    return path


def test_everything_that_ships_passes():
    results = list(check_shipped_models())
    assert [problem for result in results for problem in result.problems] == []
    subjects = " ".join(result.subject for result in results)
    for part in (
        "car.sdf: numbers equal",
        "tail.sdf: numbers equal",
        "parameters/car.yaml",
        "scenarios/turn_none.yaml",
        "parameters/hardware/motor_safety.yaml",
        "coefficients/robot_tail_line.yaml",
        "coefficients/half_cylinder.yaml",
    ):
        assert part in subjects


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


def test_good_model_of_a_user_passes(call, tmp_path):
    assert call("models", "check", sdf(tmp_path, "<damping>0.1</damping>")).exit_code == 0


@pytest.fixture
def failed(call):
    """Checks a file; the verdict is no, exit status 1, with the problems on stderr."""

    def check(path):
        result = call("models", "check", path)
        assert result.exit_code == 1, result.output
        return result.stderr

    return check


def test_joint_friction_is_refused(failed, tmp_path):
    message = failed(sdf(tmp_path, "<friction>0.2</friction>"))
    assert "joint 'hinge'" in message
    assert "friction" in message


@pytest.mark.parametrize("attribute", ["friction", "spring_stiffness"])
def test_urdf_attributes_that_drake_drops_are_refused(failed, tmp_path, attribute):
    path = tmp_path / "model.urdf"
    path.write_text(URDF.format(attribute=attribute))
    message = failed(path)
    assert attribute in message
    assert "2.5" in message


@pytest.mark.parametrize("kind", ["visual", "collision"])
def test_a_missing_mesh_is_refused(failed, tmp_path, kind):
    path = tmp_path / "model.urdf"
    shape = MESH.format(kind=kind)
    path.write_text(URDF.format(attribute="effort").replace("</link>", f"{shape}</link>"))
    assert "none.obj" in failed(path)


def test_unphysical_inertia_is_refused(failed, tmp_path):
    """Triangle inequality: no body has izz above ixx + iyy."""
    assert "model.sdf" in failed(sdf(tmp_path, izz=0.5))


def test_negative_mass_is_refused(failed, tmp_path):
    assert "model.sdf" in failed(sdf(tmp_path, mass=-1.0))


def test_missing_and_foreign_files_are_named(refused, tmp_path, untouched):
    assert "nothing.sdf" in refused("models", "check", tmp_path / "nothing.sdf")
    assert ".sdf, .urdf" in refused("models", "check", untouched)


def test_tail_is_shown_saved_and_drawn(call, refused, tmp_path):
    saved = tmp_path / "tail.yaml"
    picture = tmp_path / "tail.png"
    shown = call("models", "tail", "--out", saved, "--out", picture)
    assert shown.exit_code == 0
    lines = [line.split() for line in shown.stdout.splitlines()]
    assert ["sail", "plate", "77.87", "0", "0", "0.694", "5"] in lines
    assert ["mass_g", "174"] in lines
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert str(saved) in refused("models", "tail", "--out", saved)
    assert ".yaml" in refused("models", "tail", "--out", "tail.jpg")
    assert "other.yaml" in refused("models", "tail", "--file", tmp_path / "other.yaml")
