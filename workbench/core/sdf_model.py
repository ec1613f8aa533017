"""An SDF file as text whose numbers are set before Drake parses it.

SDF files carry topology, geometry and nominal values; the numbers that matter come from the
scenario. Poses, masses, inertias, springs and friction are written into the XML, so that what Drake
parses is what the scenario says.
"""

import itertools
import xml.etree.ElementTree as ElementTree
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.etree.ElementTree import Element, SubElement

import numpy as np
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.tree import RotationalInertia, SpatialInertia, UnitInertia

from aerodima.workbench.core.array_types import FloatArray, Vector3
from aerodima.workbench.core.errors import ModelError

DRAKE_NAMESPACE = "http://drake.mit.edu"
ElementTree.register_namespace("drake", DRAKE_NAMESPACE)
Size = float | Sequence[float] | str
"""Content of an element: a number, several, or a text."""
_CONTACT = ("point_contact_stiffness", "hunt_crossley_dissipation", "mu_static", "mu_dynamic")
_MOMENTS = ("ixx", "iyy", "izz")
_PRODUCTS = ("ixy", "ixz", "iyz")


@dataclass(frozen=True)
class Inertial:
    """Mass (kg), centre of mass in the link frame (m), moments and products of inertia about it (kg
    m2).

    Moments are xx, yy, zz, products xy, xz, yz, along the link axes.
    """

    mass: float
    com: Vector3
    moments: Vector3
    products: Vector3 = (0.0, 0.0, 0.0)

    @classmethod
    def solid(cls, mass: float, shape: UnitInertia, com: Vector3 = (0.0, 0.0, 0.0)) -> "Inertial":
        """Returns the inertia of a solid with this mass (kg) and a shape such as
        `UnitInertia.SolidBox`, centred at `com`, m.
        """
        xx, yy, zz = (mass * shape.get_moments()).tolist()
        return cls(mass, com, (xx, yy, zz))

    def about_origin(self) -> SpatialInertia:
        """Returns the inertia about the origin of the link, in its axes."""
        central = RotationalInertia(*self.moments, *self.products)
        return SpatialInertia.MakeFromCentralInertia(self.mass, np.array(self.com), central)


class SdfModel:
    """One SDF model, editable by link, joint and element name.

    Args:
        path: path of an SDF file with a single model.
        digits: number of significant digits of the numbers that are set.

    Raises:
        ModelError: no such file, not XML, or no model in it.
    """

    def __init__(self, path: Path, digits: int = 9):
        self.path = path
        self._digits = digits
        try:
            reader = ElementTree.XMLParser(target=ElementTree.TreeBuilder(insert_comments=True))
            self._root = ElementTree.fromstring(path.read_text(encoding="utf-8"), reader)
        except FileNotFoundError:
            raise ModelError(f"{path}: no such file") from None
        except (ElementTree.ParseError, OSError, UnicodeDecodeError) as error:
            raise ModelError(f"{path}: cannot be read as SDF: {error}") from None
        model = self._root.find("model")
        if model is None:
            raise ModelError(f"{path}: holds no <model>")
        self.model = model

    def set_inertial(self, link: str, inertial: Inertial) -> None:
        """Set mass, centre of mass, moments and products of inertia of a link."""
        element = self._child(self._named("link", link), "inertial")
        self._set_position(element, inertial.com)
        self._child(element, "mass").text = self._text(inertial.mass)
        inertia = self._child(element, "inertia")
        for tag, moment in zip(_MOMENTS, inertial.moments, strict=True):
            self._child(inertia, tag).text = self._text(moment)
        for tag, product in zip(_PRODUCTS, inertial.products, strict=True):
            if product or inertia.find(tag) is not None:  # SDF's default is 0
                self._child(inertia, tag).text = self._text(product)

    def inertial(self, link: str) -> Inertial:
        """Read mass, centre of mass, moments and products of inertia of a link."""
        element = self._child(self._named("link", link), "inertial")
        x, y, z = map(float, (self._child(element, "pose").text or "").split()[:3])
        inertia = self._child(element, "inertia")
        xx, yy, zz = (float(self._child(inertia, tag).text or "nan") for tag in _MOMENTS)
        xy, xz, yz = (float(inertia.findtext(tag, "0")) for tag in _PRODUCTS)
        return Inertial(
            float(self._child(element, "mass").text or "nan"), (x, y, z), (xx, yy, zz), (xy, xz, yz)
        )

    def drawn_corners(self, link: str) -> FloatArray:
        """Return the corners (n, 3) of the boxes around the visual shapes of a link, in its frame,
        m.
        """
        signs = np.array(list(itertools.product((-0.5, 0.5), repeat=3)))
        corners = []
        for element in self._named("link", link).findall("visual"):
            words = element.findtext("pose", "0 0 0 0 0 0").split()
            pose = np.array([float(word) for word in words])
            X_LV = RigidTransform(RollPitchYaw(pose[3:]), pose[:3])
            (shape,) = self._child(element, "geometry")
            if shape.tag == "box":
                size = [float(word) for word in shape.findtext("size", "").split()]
            else:
                width = 2.0 * float(shape.findtext("radius", "nan"))
                size = [width, width, float(shape.findtext("length", str(width)))]
            p_VC = signs * size
            corners.append(p_VC @ X_LV.rotation().matrix().T + X_LV.translation())
        return np.concatenate(corners)

    def place_link(
        self, link: str, inertial: Inertial, position: Sequence[float], roll: float | None = None
    ) -> None:
        """Set mass and inertia of a link, its position (m) in the model frame and its roll (rad);
        without a roll its orientation stays.
        """
        element = self._named("link", link)
        if roll is not None:
            self._child(element, "pose").text = f"0 0 0 {self._text(roll)} 0 0"
        self._set_position(element, position)
        self.set_inertial(link, inertial)

    def set_shape(
        self, link: str, shape: str, position: Sequence[float] | None = None, **sizes: Size
    ) -> None:
        """Set sizes (such as `radius=0.07`), m, and position of a visual or collision shape."""
        for element in self._shapes(link, shape):
            if position is not None:
                self._set_position(element, position)
            for tag, value in sizes.items():
                matches = list(self._child(element, "geometry").iter(tag))
                if len(matches) != 1:
                    raise ModelError(
                        f"{self.path}: shape {shape!r} of link {link!r} has no <{tag}>"
                    )
                matches[0].text = self._text(value)

    def add_shape(
        self,
        link: str,
        name: str,
        pose: Sequence[float],
        shape: str,
        *,
        colour: str | None = None,
        **sizes: Size,
    ) -> None:
        """Add a visual of a colour (`0.9 0.7 0.2 1`), or without a colour a collision shape for
        `set_contact`.

        Args:
            pose: position (m) and roll, pitch, yaw (rad) in the link frame.
            shape: `box`, `cylinder`, `sphere` or `mesh`, with its sizes, such as `radius=0.01`, m.
        """
        element = SubElement(
            self._named("link", link), "collision" if colour is None else "visual", name=name
        )
        SubElement(element, "pose").text = self._text(pose)
        form = SubElement(SubElement(element, "geometry"), shape)
        for tag, size in sizes.items():
            SubElement(form, tag).text = self._text(size)
        if colour is not None:
            SubElement(SubElement(element, "material"), "diffuse").text = colour
            return
        properties = SubElement(element, _drake("proximity_properties"))
        for tag in _CONTACT:
            SubElement(properties, _drake(tag))

    def set_contact(
        self, link: str, shape: str | None, stiffness: float, dissipation: float, friction: float
    ) -> None:
        """Set point-contact stiffness (N/m), Hunt-Crossley dissipation (s/m) and friction of
        collision shapes.
        """
        values = dict(zip(_CONTACT, (stiffness, dissipation, friction, friction), strict=True))
        for element in self._shapes(link, shape, "collision"):
            properties = self._child(element, _drake("proximity_properties"))
            for tag, value in values.items():
                self._child(properties, _drake(tag)).text = self._text(value)

    def set_joint(self, joint: str, **values: float) -> None:
        """Set a joint's damping, spring stiffness and reference, lower and upper limit, effort."""
        axis = self._child(self._named("joint", joint), "axis")
        for tag, value in values.items():
            parent = self._child(
                axis, "limit" if tag in ("lower", "upper", "effort") else "dynamics"
            )
            self._child(parent, tag).text = self._text(value)

    def set_rotor(self, joint: str, inertia: float, gear_ratio: float) -> None:
        """Set rotor inertia (kg m2, before the gearbox) and gear ratio of a joint's actuator."""
        element = self._named("joint", joint)
        self._child(element, _drake("rotor_inertia")).text = f"{inertia:.15g}"
        self._child(element, _drake("gear_ratio")).text = self._text(gear_ratio)

    def set_controller_gains(self, joint: str, stiffness: float, damping: float) -> None:
        """Set the implicit position control (N m/rad, N m s/rad) of the actuator of a joint."""
        gains = self._child(self._named("joint", joint), _drake("controller_gains"))
        gains.set("p", self._text(stiffness))
        gains.set("d", self._text(damping))

    def fix_joint(self, joint: str) -> None:
        """Turn a joint into a fixed one at its zero position."""
        element = self._named("joint", joint)
        element.set("type", "fixed")
        element.remove(self._child(element, "axis"))

    def remove_shapes(self, link: str, shape: str | None = None, kind: str = "*") -> None:
        """Remove visuals and collision shapes of a link, or only those of one name or one kind."""
        for element in self._shapes(link, shape, kind):
            self._named("link", link).remove(element)

    def remove_link(self, link: str, joint: str) -> None:
        """Remove a link with the joint that holds it."""
        self.model.remove(self._named("joint", joint))
        self.model.remove(self._named("link", link))

    def text(self) -> str:
        """Write the model as an SDF document."""
        document = ElementTree.tostring(self._root, encoding="unicode")
        return f'<?xml version="1.0"?>\n{document}\n'

    def _named(self, kind: str, name: str) -> Element:
        elements = {str(element.get("name")): element for element in self.model.findall(kind)}
        if name not in elements:
            raise ModelError(f"{self.path}: no {kind} {name!r}; it has {', '.join(elements)}")
        return elements[name]

    def _shapes(self, link: str, shape: str | None, kind: str = "*") -> list[Element]:
        kinds = ("visual", "collision") if kind == "*" else (kind,)
        elements = [element for element in self._named("link", link) if element.tag in kinds]
        if shape is None:
            return elements
        named = [element for element in elements if element.get("name") == shape]
        if not named:
            raise ModelError(f"{self.path}: link {link!r} has no shape {shape!r}")
        return named

    def _child(self, element: Element, tag: str) -> Element:
        child = element.find(tag)
        if child is None:
            raise ModelError(
                f"{self.path}: <{element.tag} name={element.get('name')!r}> has no <{tag}>"
            )
        return child

    def _text(self, value: Size) -> str:
        """Write a text as it is, a number with the digits of the model, several with blanks."""
        if isinstance(value, str):
            return value
        if isinstance(value, Sequence):
            return " ".join(map(self._text, value))
        return f"{value:.{self._digits}g}"

    def _set_position(self, element: Element, position: Sequence[float]) -> None:
        pose = self._child(element, "pose")
        angles = (pose.text or "0 0 0 0 0 0").split()[3:]
        pose.text = " ".join([*map(self._text, position), *angles])


def _drake(tag: str) -> str:
    return f"{{{DRAKE_NAMESPACE}}}{tag}"
