"""SDF files as text with numbers: what is set is what Drake parses, and the files on disk carry the
parameters.
"""

import re

import pytest

from aerodima.workbench.cli.model_check import nominal_models, sdf_differences
from aerodima.workbench.core.errors import ModelError
from aerodima.workbench.core.sdf_model import Inertial, SdfModel
from tests.refusals import assert_refused

ROD = """<?xml version="1.0"?>
<sdf version="1.9" xmlns:drake="http://drake.mit.edu">
  <model name="rod">
    <!-- A rod on a hinge. -->
    <link name="rod">
      <pose>0.1 0.2 0.3 0 0 1.5</pose>
      <inertial>
        <pose>0 0 0 0 0 0</pose>
        <mass>1</mass>
        <inertia><ixx>1</ixx><iyy>1</iyy><izz>1</izz></inertia>
      </inertial>
      <collision name="tip">
        <pose>0 0 0 0 0 0</pose>
        <geometry><sphere><radius>0.1</radius></sphere></geometry>
        <drake:proximity_properties>
          <drake:point_contact_stiffness>1</drake:point_contact_stiffness>
          <drake:hunt_crossley_dissipation>1</drake:hunt_crossley_dissipation>
          <drake:mu_static>1</drake:mu_static>
          <drake:mu_dynamic>1</drake:mu_dynamic>
        </drake:proximity_properties>
      </collision>
    </link>
    <joint name="hinge" type="revolute">
      <drake:rotor_inertia>0</drake:rotor_inertia>
      <drake:gear_ratio>1</drake:gear_ratio>
      <drake:controller_gains p="1" d="1"/>
      <parent>world</parent>
      <child>rod</child>
      <axis>
        <xyz>0 1 0</xyz>
        <limit><lower>-1</lower><upper>1</upper><effort>1</effort></limit>
        <dynamics><damping>0</damping></dynamics>
      </axis>
    </joint>
  </model>
</sdf>
"""
DRAKE = "{http://drake.mit.edu}"


@pytest.fixture
def rod(tmp_path):
    (tmp_path / "rod.sdf").write_text(ROD)
    return SdfModel(tmp_path / "rod.sdf")


def numbers(model, place):
    """Of the element at a place below the model."""
    return [float(word) for word in model.model.find(place).text.split()]


@pytest.mark.parametrize("model", nominal_models(), ids=lambda model: model.path.name)
def test_file_on_disk_carries_the_numbers_of_the_parameters(model):
    assert sdf_differences(model) == []


def test_difference_between_file_and_parameters_is_found():
    car = nominal_models()[0]
    inertial = car.inertial("chassis")
    car.set_inertial("chassis", Inertial(inertial.mass * 1.001, inertial.com, inertial.moments))
    (problem,) = sdf_differences(car)
    assert re.search(r"<mass>.*</mass>.*<mass>.*</mass>", problem)


def test_numbers_that_are_set_are_the_numbers_of_the_document(rod):
    inertial = Inertial(2.5, (0.1, -0.2, 0.3), (0.4, 0.5, 0.6))
    rod.set_inertial("rod", inertial)
    assert rod.inertial("rod") == inertial
    rod.set_contact("rod", "tip", 2e4, 3.0, 0.7)
    rod.set_shape("rod", "tip", (1, 2, 3), radius=0.25)
    rod.set_joint("hinge", lower=-0.5, upper=0.75, effort=9, damping=0.1)
    rod.set_rotor("hinge", 4.14e-5, 10)
    rod.set_controller_gains("hinge", 200, 2)
    link = "link[@name='rod']"
    joint = "joint[@name='hinge']"
    contact = f"{link}/collision/{DRAKE}proximity_properties"
    expected = {
        f"{link}/inertial/mass": [2.5],
        f"{link}/inertial/pose": [0.1, -0.2, 0.3, 0, 0, 0],
        f"{link}/inertial/inertia/ixx": [0.4],
        f"{link}/inertial/inertia/iyy": [0.5],
        f"{link}/inertial/inertia/izz": [0.6],
        f"{contact}/{DRAKE}point_contact_stiffness": [2e4],
        f"{contact}/{DRAKE}hunt_crossley_dissipation": [3.0],
        f"{contact}/{DRAKE}mu_static": [0.7],
        f"{contact}/{DRAKE}mu_dynamic": [0.7],
        f"{link}/collision/pose": [1, 2, 3, 0, 0, 0],
        f"{link}/collision/geometry/sphere/radius": [0.25],
        f"{joint}/axis/limit/lower": [-0.5],
        f"{joint}/axis/limit/upper": [0.75],
        f"{joint}/axis/limit/effort": [9],
        f"{joint}/axis/dynamics/damping": [0.1],
        f"{joint}/{DRAKE}rotor_inertia": [4.14e-5],
        f"{joint}/{DRAKE}gear_ratio": [10],
    }
    assert {place: numbers(rod, place) for place in expected} == expected
    assert dict(rod.model.find(f"{joint}/{DRAKE}controller_gains").items()) == {
        "p": "200",
        "d": "2",
    }


def test_position_moves_a_link_and_leaves_its_orientation(rod):
    inertial = rod.inertial("rod")
    rod.place_link("rod", inertial, (4, 5, 6))
    assert numbers(rod, "link/pose") == [4, 5, 6, 0, 0, 1.5]
    rod.place_link("rod", inertial, (4, 5, 6), roll=0.5)
    assert numbers(rod, "link/pose") == [4, 5, 6, 0.5, 0, 0]


def test_document_that_is_written_reads_the_same_and_keeps_its_comments(rod, tmp_path):
    rod.set_rotor("hinge", 4.14e-5, 10)
    (tmp_path / "again.sdf").write_text(rod.text())
    assert SdfModel(tmp_path / "again.sdf").text() == rod.text()
    assert "<!-- A rod on a hinge. -->" in rod.text()


def test_fixed_joint_has_no_axis(rod):
    rod.fix_joint("hinge")
    assert 'type="fixed"' in rod.text()
    assert "<axis>" not in rod.text()


@pytest.mark.parametrize(
    ("edit", "named"),
    [
        (lambda m: m.inertial("rud"), ("'rud'", "rod")),
        (lambda m: m.set_joint("hinj", effort=1), ("'hinj'", "hinge")),
        (lambda m: m.set_joint("hinge", spring_stiffness=1), ("<spring_stiffness>",)),
        (lambda m: m.set_shape("rod", "top", radius=1.0), ("'rod'", "'top'")),
        (lambda m: m.set_shape("rod", "tip", length=1.0), ("'rod'", "'tip'", "<length>")),
    ],
    ids=["link", "joint", "element", "shape", "size"],
)
def test_place_that_does_not_exist_is_named(rod, edit, named):
    assert_refused(lambda: edit(rod), ModelError, "rod.sdf", *named)


@pytest.mark.parametrize("content", ["<sdf><model>", "", "<sdf/>", None])
def test_file_that_is_no_model_is_named(tmp_path, content):
    path = tmp_path / "bad.sdf"
    if content is not None:
        path.write_text(content)
    assert_refused(lambda: SdfModel(path), ModelError, "bad.sdf")
