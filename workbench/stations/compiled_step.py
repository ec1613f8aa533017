"""What drives the plant in one step, compiled with numba: the same functions, the same results to rounding.

numba comes with the extra `compiled`; without it, or with its own `NUMBA_DISABLE_JIT=1`, the functions are interpreted.
In every call numba reads each number of a named tuple anew, which takes longer than to interpret the step. So the
numbers of a car are packed once into one array, and only compiled code sees the named tuples. One power in a thousand
differs in its last bit (compiled code takes squares and roots where Python calls `pow`), so the version of numba is one
of those that a run depends on.
"""

import hashlib
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from aerodima.workbench.actuators import ak70, drive, servo
from aerodima.workbench.aero import plates, sail_motion, sections
from aerodima.workbench.config.array_types import FloatArray
from aerodima.workbench.errors import UserError
from aerodima.workbench.logs.schema import compiler_version
from aerodima.workbench.plants import joint_friction
from aerodima.workbench.plants import tail as arm
from aerodima.workbench.stations import step_drives as step

Drives = Callable[[float, FloatArray], Any]
"""What drives the plant (18), see `step_drives.DRIVES_SIZE`, at a time, s, with the inputs of `FusedStep` (n)."""

_CALLED: tuple[Callable[..., Any], ...] = (
    ak70.loaded_torque, ak70.mit_torque, drive.shaft_torque, drive.steady_speed, joint_friction.friction_torque,
    plates.plate_force, plates.plates_force, sail_motion.generalised_force, sail_motion.rotation_rows,
    sail_motion.sail_motion, sections.line_motion, servo.ackermann, servo.knuckle_angles, servo.knuckle_motion,
    servo.steering_motion, step.about_origin, step.air_force, step.joint_torque, step.sail_of, step.step_drives,
    step.wind_of, arm.inertia_about_joints,
)  # fmt: skip
"""`step_drives` and all that it calls."""

PLACES = (Path(__file__).parent / "__pycache__", Path("~/.cache/aerodima"))
"""Where compiled code is kept, in a folder for each state of the sources: the first that can be written."""


def drives_of(car: step.CarNumbers, tail: step.TailNumbers | None) -> Drives:
    """The function of a car: compiled where numba is installed and the sail is one line of sections or none."""
    if compiler_version() is None or (tail is not None and len(tail.strips) != 1):
        return lambda time, inputs: np.array(step.step_drives(time, inputs.tolist(), car, tail))
    compiled, drives = _compiled(tail is not None), np.zeros(step.DRIVES_SIZE)
    numbers = [np.array(part, dtype=float) for part in _packed(car, tail)]

    def calculate(time: float, inputs: FloatArray) -> FloatArray:
        compiled(time, inputs, *numbers, drives)
        return drives

    return calculate


_known: dict[bool, Callable[..., None]] = {}


def _compiled(with_tail: bool) -> Callable[..., None]:
    """Fills the drives (18) from time, inputs and what `_packed` made; compiled at its first call, or read.

    Raises:
        UserError: numba is there but cannot be imported.
    """
    if with_tail in _known:
        return _known[with_tail]
    try:
        import numba
        from numba.extending import register_jitable
    except ImportError as error:
        raise UserError(
            f"numba {compiler_version()}: {error}; allowed: a version that can be imported, or NUMBA_DISABLE_JIT=1"
        ) from None
    called: Any
    for called in (*_CALLED, _car, _tail) if not _known else ():
        register_jitable(called)
    function, folder = _drive_car_with_tail if with_tail else _drive_car, _cache_folder()
    if folder is None or not any(
        folder.rglob(f"*{function.__name__}-*py{sys.version_info[0]}{sys.version_info[1]}.nbi")
    ):
        print("compiling what drives the plant: some 10 s", file=sys.stderr, flush=True)
    config: Any = numba.config
    before, config.CACHE_DIR = config.CACHE_DIR, str(folder or "")
    try:
        _known[with_tail] = numba.njit(cache=folder is not None)(function)
    finally:
        config.CACHE_DIR = before
    return _known[with_tail]


def _cache_folder() -> Path | None:
    """For compiled code of the sources as they are: numba would not see that a function elsewhere has changed."""
    files = {function.__code__.co_filename for function in _CALLED} | {__file__}
    sources = b"".join(Path(file).read_bytes() for file in sorted(files))
    for place in PLACES:
        try:
            folder = place.expanduser() / hashlib.sha256(sources).hexdigest()[:16]
            folder.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryFile(dir=folder):
                return folder
        except (OSError, RuntimeError):  # not to be written, or nobody's home
            continue
    return None


def _packed(car: step.CarNumbers, tail: step.TailNumbers | None) -> tuple[Any, ...]:
    """The numbers as `_car` and `_tail` read them; of the sail distances and areas apart."""
    linkage = car.linkage
    numbers = [*car.drive, car.gain, car.radius, car.servo_rate]
    numbers += [linkage.linkage == "parallel", linkage.wheelbase, linkage.track]
    if tail is None:
        return (numbers,)
    (strip,) = tail.strips
    others = [*tail.p_BoSo_B, tail.step, *tail.motor, *tail.line, tail.rotor, *tail.arm]
    others += [tail.coulomb, tail.viscous, tail.tanh_gain, tail.density, tail.windy]
    line = [*strip.axis_B, *strip.normal_B, *strip.p_BoRo_B, *strip.plates]
    return numbers, others + line, strip.distances, strip.areas


def _car(n: FloatArray) -> step.CarNumbers:
    linkage = "parallel" if n[8] != 0.0 else "ackermann"
    return step.CarNumbers(
        step.DriveNumbers(n[0], n[1], n[2], n[3] != 0.0, n[4]),
        n[5],
        n[6],
        step.LinkageNumbers(linkage, n[9], n[10]),
        n[7],
    )


def _tail(n: FloatArray, distances: Any, areas: Any) -> step.TailNumbers:
    motor = step.MotorNumbers(n[4], n[5], n[6], n[7])
    inertia = arm.ArmInertia(n[11], n[12], n[13], n[14])
    section_law = plates.Plates(n[29], n[30], n[31])
    line = step.Strip(
        (n[20], n[21], n[22]), (n[23], n[24], n[25]), (n[26], n[27], n[28]), distances, areas, section_law
    )
    return step.TailNumbers(
        (n[0], n[1], n[2]), n[3], motor, (n[8], n[9]), n[10], inertia, n[15], n[16], n[17], n[18], n[19] != 0.0, (line,)
    )


def _drive_car(time: float, inputs: Any, car: FloatArray, drives: FloatArray) -> None:
    found = step.step_drives(time, inputs, _car(car), None)
    for index, value in enumerate(found):
        drives[index] = value


def _drive_car_with_tail(
    time: float, inputs: Any, car: FloatArray, tail: FloatArray, distances: FloatArray, areas: FloatArray,
    drives: FloatArray,
) -> None:  # fmt: skip
    found = step.step_drives(time, inputs, _car(car), _tail(tail, distances, areas))
    for index, value in enumerate(found):
        drives[index] = value
