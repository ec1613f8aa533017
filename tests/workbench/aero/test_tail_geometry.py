"""A tail as an object: closed forms of its shapes, the car's tail made of densities, files, and
what is refused.
"""

import math
from itertools import product

import numpy as np
import pytest
from numpy.testing import assert_allclose

from aerodima.workbench.aero.sections import SectionLayout
from aerodima.workbench.aero.tail_geometry import Plate, TailArm, TailGeometry
from aerodima.workbench.aero.tail_mass import inertial_of_inertia
from aerodima.workbench.car.tail_file import read_tail, write_tail
from aerodima.workbench.car.tail_plant import tail_geometry, tail_sdf
from aerodima.workbench.core.errors import ModelError
from aerodima.workbench.core.sdf_model import Inertial
from aerodima.workbench.scenario.scenario import load_scenario, scenario_from_dict
from tests.refusals import assert_refused

EXACT = {"rtol": 1e-9, "atol": 1e-13}


def plate(**changes):
    values = {
        "name": "sail", "root": (0.0, 0.0, 0.3), "lengths": (0.4,), "chords": (0.2, 0.2),
        "normal": (0.0, -1.0, 0.0),
        "density": 0.5,
    }  # fmt: skip
    return Plate(**(values | changes))


def arm(*lengths, density=0.06, **changes):
    return TailArm(lengths=lengths, density=density, **changes)


def tail(*plates, **changes):
    return TailGeometry(
        **({"name": "t", "arm": arm(0.7), "plates": plates or (plate(),)} | changes)
    )


def about_origin(inertia):
    return inertia.CalcRotationalInertia().CopyToFullMatrix3()


def second(inertia):
    moments = about_origin(inertia)
    return np.trace(moments) / 2 * np.eye(3) - moments


GAUSS = list(zip(*np.polynomial.legendre.leggauss(20), strict=True))


def surface(shape, kind):
    """Points of Gauss and Legendre on a plate as one of some kind, in T (n, 3), and the mass at
    each (n), kg.
    """
    found = []
    start = np.array(shape.root)
    last = len(shape.lengths) - 1
    for number, length in enumerate(shape.lengths):
        near, far = shape.chords[number : number + 2]
        axis = np.array(shape.axes[number % len(shape.axes)])
        axis /= np.linalg.norm(axis)
        normal = shape.normal - (axis @ shape.normal) * axis
        normal /= np.linalg.norm(normal)
        across = np.cross(normal, axis)
        end = start + length * axis
        for (x, along), (y, over) in product(GAUSS, GAUSS):
            weight = 0.25 * along * over
            share = 0.5 * (1.0 + x)
            width = near + share * (far - near)
            place = start + share * (end - start)
            if kind == "plate":
                mass = shape.density * length * width
                found.append((place + 0.5 * y * width * across, weight * mass))
                continue
            # A half circle of diameter 1, and the slant of a cone.
            rim = 0.5 * (math.sin(math.pi / 2 * y) * across + math.cos(math.pi / 2 * y) * normal)
            mass = shape.density * math.pi / 2 * width * math.hypot(length, (far - near) / 2)
            found.append((place + width * rim, weight * mass))
            for middle, chord, closed in ((start, near, number == 0), (end, far, number == last)):
                if closed:
                    mass = shape.cap_density * math.pi / 4 * chord**2 * share
                    found.append((middle + share * chord * rim, weight * mass))
        start = end
    points, masses = zip(*found, strict=True)
    return np.array(points), np.array(masses)


BENT = ((0.0, 0.0, 1.0), (0.6, 0.0, 0.8))


@pytest.mark.parametrize(
    "shape",
    [
        plate(chords=(0.2, 0.1)),
        plate(lengths=(0.2, 0.3), chords=(0.2, 0.1, 0.06), axes=BENT),
        plate(kind="half_shell"),
        plate(kind="half_shell", chords=(0.2, 0.1), root=(0.0, 0.0, 0.0), cap_density=1.5),
        plate(
            kind="half_shell",
            lengths=(0.2, 0.3),
            chords=(0.2, 0.1, 0.06),
            cap_density=1.0,
            root=(0.1, -0.2, 0.3),
            axes=((0.3, -0.5, 1.1), (0.4, -0.5, 1.0)),
            normal=(1.0, 0.7, -0.2),
        ),
    ],
    ids=["trapezoid", "bent", "half cylinder", "closed half cone", "closed, bent and turned"],
)
def test_mass_moments_and_area_are_those_of_the_surface(shape):
    """The planform is that of the flat plate with the same outline."""
    points, masses = surface(shape, shape.kind)
    inertia = shape.inertia
    assert inertia.get_mass() == pytest.approx(masses.sum(), rel=1e-9)
    assert_allclose(inertia.get_com(), masses @ points / masses.sum(), **EXACT)
    assert_allclose(second(inertia), masses * points.T @ points, **EXACT)
    points, masses = surface(shape, "plate")
    assert shape.area == pytest.approx(masses.sum() / shape.density, rel=1e-9)
    assert_allclose(shape.centre_of_pressure, masses @ points / masses.sum(), **EXACT)


def test_bent_parts_are_their_pieces():
    whole = plate(lengths=(0.2, 0.3), chords=(0.2, 0.1, 0.06), axes=BENT)
    assert len(whole.section_layouts()) == 2
    rod = arm(0.5, 0.5, density=0.1, axes=((0.0, 0.0, 1.0), (0.0, 1.0, 0.0)))
    inertia = about_origin(rod.inertia)
    # A rod upright to 0.5 m, then one along y: 1/3 m l^2, and 1/12 m l^2 + m (l^2/4 + l^2).
    assert inertia[0, 0] == pytest.approx(0.05 * 0.25 * (1 / 3 + 1 / 12 + 5 / 4), rel=1e-9)


def test_sections_share_the_area_and_have_its_centre():
    shape = plate(lengths=(0.2, 0.3), chords=(0.2, 0.1, 0.06), sections=3)
    (layout,) = shape.section_layouts()
    assert layout.number == 6
    assert sum(layout.areas) == pytest.approx(shape.area, rel=1e-12)
    assert_allclose(
        np.asarray(layout.areas) @ layout.p_BoSi_B / shape.area, shape.centre_of_pressure, **EXACT
    )
    assert layout.end == pytest.approx(0.8)


def test_centre_of_pressure_counts_what_a_direction_sees():
    both = tail(
        plate(), plate(name="rudder", normal=(1.0, 0.0, 0.0), chords=(0.1, 0.1), lengths=(0.1,))
    )
    assert_allclose(both.centre_of_pressure(), [0, 0, 0.5], **EXACT)
    assert_allclose(both.centre_of_pressure((1.0, 0.0, 0.0)), [0, 0, 0.35], **EXACT)
    assert_refused(lambda: both.centre_of_pressure((0.0, 0.0, 1.0)), ModelError)


@pytest.mark.parametrize("name", ["turn_swing", "turn_designed"])
def test_tail_of_a_scenario_made_of_densities_is_the_same_tail(name):
    scenario = load_scenario(name)
    parameters = scenario.tail
    motor = scenario.tail_motor
    car = scenario.car
    known = tail_geometry(parameters)
    made = known.from_densities()
    assert made.arm_inertial is None
    for part in ("arm_mass", "sail_mass"):
        one = getattr(known, part)
        other = getattr(made, part)
        for field in ("mass", "com", "moments", "products"):
            assert_allclose(getattr(one, field), getattr(other, field), **EXACT)
    # Drake parses the same text, so that every outcome is the same too.
    assert tail_sdf(parameters, motor, car, made).text() == tail_sdf(parameters, motor, car).text()
    assert made.inertial.mass == pytest.approx(parameters.mass, rel=1e-12)


def test_sections_of_the_cars_tail_are_those_of_its_parameters_to_the_last_bit():
    parameters = load_scenario("turn_swing").tail
    geometry = tail_geometry(parameters)
    (layout,) = geometry.section_layouts()
    length = parameters.length
    sail = parameters.sail_length
    assert layout == SectionLayout.strip(
        start=length - sail, length=sail, width=parameters.sail_width, normal_B=(0.0, -1.0, 0.0)
    )
    whole = SectionLayout.strip(
        start=0.0, length=length, width=parameters.sail_width, normal_B=(0.0, 1.0, 0.0)
    )
    assert geometry.added_mass_layout() == whole


def test_file_gives_the_same_tail_to_the_last_bit(tmp_path):
    bent = tail(
        plate(
            kind="half_shell",
            cap_density=1.5,
            lengths=(0.1, 0.3),
            chords=(0.1, 0.2, 0.123456789012345),
        ),
        plate(name="board", normal=(1.0, 0.0, 0.0), root=(0.0, -0.2, 0.3), depth=0.01),
        arm=arm(0.4, 0.4, axes=BENT),
    )
    for number, geometry in enumerate((bent, tail_geometry(scenario_from_dict({}).tail))):
        assert read_tail(write_tail(geometry, tmp_path / f"{number}.yaml")) == geometry


def test_known_mass_and_inertia_replace_those_of_the_densities():
    known = Inertial(0.2, (0.0, 0.01, 0.5), (0.02, 0.02, 0.001), (0.0, 0.0, 0.0005))
    geometry = tail(sail_inertial=known)
    assert geometry.sail_mass == known
    total = geometry.inertial
    assert total.mass == pytest.approx(0.2 + 0.06 * 0.7)
    assert total.com[1] == pytest.approx(0.2 * 0.01 / total.mass)
    again = inertial_of_inertia(known.about_origin())
    assert_allclose(again.moments + again.products, known.moments + known.products, **EXACT)


def test_plates_that_overlap_are_refused_and_those_that_touch_or_cross_are_not():
    inside = plate(name="other", root=(0.05, 0.0, 0.5), lengths=(0.1,), chords=(0.01, 0.01))
    assert_refused(lambda: tail(plate(), inside), ModelError, "'sail'", "'other'")
    tail(plate(), plate(name="above", root=(0.0, 0.0, 0.7)))
    tail(plate(), plate(name="beside", root=(0.2, 0.0, 0.3)))
    tail(plate(), plate(name="across", normal=(1.0, 0.0, 0.0)))
    tail(plate(), plate(name="behind", root=(0.0, 0.05, 0.3)))


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"chords": (0.2, -0.1)}, ("chords.1", "-0.1")),
        ({"lengths": (math.nan,)}, ("lengths.0", "nan")),
        ({"density": 0.0}, ("density", "0.0", "kg/m2")),
        ({"chords": (0.2,)}, ("'sail'", "lengths", "1", "chords")),
        ({"normal": (0.0, 0.0, 2.0)}, ("'sail'", "normal", "(0.0, 0.0, 2.0)")),
        ({"kind": "sphere"}, ("kind", "'sphere'", "'plate'", "'half_shell'")),
        ({"cap_density": 1.0}, ("'sail'", "cap_density", "1")),
        ({"kind": "half_shell", "depth": 0.1}, ("'sail'", "depth", "0.1")),
        ({"sections": 0}, ("sections", "0")),
    ],
    ids=str,
)
def test_impossible_plate_is_refused(changes, named):
    assert_refused(lambda: plate(**changes), ModelError, *named)


@pytest.mark.parametrize(
    ("make", "named"),
    [
        (lambda: TailGeometry(name="t", arm=arm(0.7), plates=()), ("plates",)),
        (lambda: tail(plate(), plate(root=(0.0, 0.0, 2.0))), ("'sail'",)),
        (lambda: tail(arm=arm(0.4, 0.4, axes=BENT)).added_mass_layout(), ()),
    ],
    ids=["no plate", "name", "bent"],
)
def test_tails_that_cannot_be_are_refused(make, named):
    assert_refused(make, ModelError, *named)


@pytest.mark.parametrize(
    ("old", "new", "named"),
    [
        ("density: 0.5", "density: 0.5 kg", ("density", "'kg/m2'")),
        ("root: [0.0, 0.0, 0.3]", "root: [0.0, 0.3]", ("plates.0.root",)),
        ("aerodima/tail/1", "aerodima/tail/9", ("aerodima/tail/9",)),
    ],
)
def test_wrong_file_is_refused_by_file_and_place(tmp_path, old, new, named):
    path = write_tail(tail(), tmp_path / "tail.yaml")
    text = path.read_text(encoding="utf-8")
    assert old in text
    path.write_text(text.replace(old, new), encoding="utf-8")
    assert_refused(lambda: read_tail(path), ModelError, str(path), *named)
