"""The state of car and console as the page shows it."""

from __future__ import annotations

import math
from typing import Any

from aerodima.hardware.console.operator_radio import REPORT_SILENCE, OperatorRadio
from aerodima.hardware.console.page_messages import MODES
from aerodima.hardware.devices.motor_state import MotorFault
from aerodima.hardware.devices.source_fault import SourceFault
from aerodima.hardware.protocol.car_report import CarReport
from aerodima.workbench.config.signal_table import STATUS_SOURCES

_MODE_NAMES = {mode: name for name, mode in MODES.items()}
_MOTORS = ("tail_pitch", "tail_roll")


def radio_state(radio: OperatorRadio, now: float) -> dict[str, Any]:
    """What is known of the car, plain data without NaN or infinity (None instead).

    Ages in s; angles in rad, rates in rad/s, torques in N m, speed in m/s. `link_age` is how old the car takes the
    operator for, with the age of the report that says so.
    """
    age, report = radio.report_age(now), radio.report
    fault = radio.fault(now)
    current = report is not None and age <= REPORT_SILENCE and not fault
    return {
        "fault": fault,
        "stopped_by": radio.stopped_by,
        "confirmed": radio.confirmed,
        "mode": _MODE_NAMES[radio.mode],
        "heard": current,
        "armed": radio.armed(now),
        "report_age": _finite(age),
        "link_age": None if report is None else _finite(age + report.operator_age),
        "report": _report_state(report) if report is not None else None,
    }


def _report_state(report: CarReport) -> dict[str, Any]:
    return {
        "stopped": report.stopped,
        "mode": _MODE_NAMES[report.mode],
        "has_tail": report.has_tail,
        "faults": [
            {"source": source.replace("_", " "), "fault": _fault_name(source, code)}
            for source, code in zip(STATUS_SOURCES, report.faults, strict=True)
            if code != SourceFault.NONE and not (code == SourceFault.NOT_FITTED and _may_lack(source, report))
        ],
        "text": report.text,
        "yaw_rate": _finite(report.yaw_rate),
        "roll": _finite(report.roll),
        "tail_pitch": _finite(report.tail_pitch) if report.has_tail else None,
        "tail_roll": _finite(report.tail_roll) if report.has_tail else None,
        "torque_pitch": _finite(report.torque_pitch) if report.has_tail else None,
        "torque_roll": _finite(report.torque_roll) if report.has_tail else None,
        "speed": _finite(report.speed),
    }


def _may_lack(source: str, report: CarReport) -> bool:
    """Whether 1 says "not fitted" of this source; of a motor it is a fault."""
    return source not in _MOTORS or not report.has_tail


def _fault_name(source: str, code: int) -> str:
    codes: type[MotorFault] | type[SourceFault] = MotorFault if source in _MOTORS else SourceFault
    try:
        return codes(code).name.lower().replace("_", " ")
    except ValueError:
        return f"fault {code}"


def _finite(value: float) -> float | None:
    return round(value, 5) if math.isfinite(value) else None
