"""Tail files: a `TailGeometry` as YAML of schema `aerodima/tail/1`; units may be given, and are checked."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any, Literal

import yaml
from pydantic import Field

from aerodima.workbench.atomic_write import write_atomically
from aerodima.workbench.config.checked_files import QuantityModel, checked, quantity, read_yaml
from aerodima.workbench.errors import ModelError
from aerodima.workbench.plants.sdf_model import Inertial
from aerodima.workbench.plants.tail_geometry import TailArm, TailGeometry
from aerodima.workbench.plants.tail_plate import UP, Plate

SCHEMA = "aerodima/tail/1"

_Vector = Annotated[tuple[float, float, float], Field(strict=False)]
_Numbers = Annotated[tuple[float, ...], Field(strict=False, min_length=1)]
_Vectors = Annotated[tuple[_Vector, ...], Field(strict=False, min_length=1)]


class ArmEntry(QuantityModel):
    """The rod."""

    lengths: _Numbers = quantity("m", "of its straight pieces from the joints on")
    density: float = quantity("kg/m", "mass over length", gt=0)
    radius: float = quantity("m", "drawn, and for its moment about its own axis", default=0.006, gt=0)
    axes: _Vectors = Field((UP,), description="directions of the pieces; one is enough where all are alike")


class PlateEntry(QuantityModel):
    """A plate or half shell."""

    name: str = quantity("1", "of the plate", min_length=1, max_length=40)
    kind: Literal["plate", "half_shell"] = Field("plate", description="flat, or a half cylinder")
    root: _Vector = quantity("m", "middle of its near edge")
    lengths: _Numbers = quantity("m", "of its straight pieces")
    chords: _Numbers = quantity("m", "widths at the ends of the pieces, one more than these")
    axes: _Vectors = Field((UP,), description="directions of the pieces; one is enough where all are alike")
    normal: _Vector = quantity("1", "direction of the face; of a half shell it leaves the round side")
    density: float = quantity("kg/m2", "mass over area of the material", gt=0)
    depth: float = quantity("m", "over which a plate's mass is spread", default=0.0, ge=0)
    cap_density: float = quantity("kg/m2", "of half discs at both ends of a half shell", default=0.0, ge=0)
    sections: int = Field(5, description="of each piece, where the air acts", ge=1, le=100)


class InertialEntry(QuantityModel):
    """Mass and inertia that are known better than by densities."""

    mass: float = quantity("kg", "of the part", gt=0)
    com: _Vector = quantity("m", "centre of mass")
    moments: _Vector = quantity("kg m2", "xx, yy, zz about that centre")
    products: _Vector = Field((0.0, 0.0, 0.0), description="xy, xz, yz about that centre, kg m2")


class TailFile(QuantityModel):
    """The whole file."""

    schema_: Literal["aerodima/tail/1"] = Field(alias="schema")
    name: str = quantity("1", "of the tail", min_length=1, max_length=40)
    arm: ArmEntry
    plates: Annotated[tuple[PlateEntry, ...], Field(strict=False, min_length=1)]
    arm_inertial: InertialEntry | None = Field(None, description="of the arm, in place of its density's")
    sail_inertial: InertialEntry | None = Field(None, description="of all plates, in place of their densities'")


def read_tail(path: str | Path) -> TailGeometry:
    """Reads a tail file.

    Raises:
        ModelError: no such file, a wrong key, value or unit, or a tail that cannot be; names the file.
    """
    place = Path(path)
    found = checked(TailFile, read_yaml(place, ModelError), str(place), ModelError, schema=SCHEMA)
    try:
        return TailGeometry(
            found.name,
            TailArm(**found.arm.model_dump()),
            tuple(Plate(**plate.model_dump()) for plate in found.plates),
            _inertial(found.arm_inertial),
            _inertial(found.sail_inertial),
        )
    except ModelError as error:
        raise ModelError(f"{place}: {error}") from None


def _inertial(entry: InertialEntry | None) -> Inertial | None:
    return None if entry is None else Inertial(**entry.model_dump())


def write_tail(geometry: TailGeometry, path: str | Path, *, force: bool = False) -> Path:
    """Writes a tail file; what is read again is the same tail, to the last bit.

    Raises:
        ModelError: the file exists and `force` is not given.
    """
    found: dict[str, Any] = {"schema": SCHEMA, **asdict(geometry)}
    kept = {key: value for key, value in found.items() if value is not None}
    text = yaml.safe_dump(_plain(kept), sort_keys=False, default_flow_style=None, width=120)
    return write_atomically(Path(path), text, force, ModelError)


def _plain(value: Any) -> Any:
    """Lists for tuples, floats for NumPy's."""
    if isinstance(value, dict):
        return {key: _plain(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(entry) for entry in value]
    return value if isinstance(value, str | int) else float(value)
