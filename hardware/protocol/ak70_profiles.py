"""Firmware profiles of the AK70-10: which numbers the fields of its frames stand for (design section 14).

The frames carry no version, so the profile is chosen by the user and checked at start-up
(`aerodima.hardware.devices.profile_check`). Sources disagree: 25 N m is the manual V1.0.8, 24 and 24.8 N m are printed
elsewhere for the same motor, and the sample code of the manual has another position range.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

from aerodima.workbench.errors import HardwareError

FAULT_NAMES: Mapping[int, str] = MappingProxyType(
    {
        1: "over-temperature",
        2: "over-current",
        3: "over-voltage",
        4: "under-voltage",
        5: "encoder",
        6: "phase current unbalance",
    }
)
"""Fault byte of the 8-byte reply; 0 is none. The list of public drivers of the series, equal to the manual's."""


@dataclass(frozen=True)
class FirmwareProfile:
    """Ranges of one firmware. A field of n bits spans its range in 2^n - 1 steps.

    Attributes:
        name: how a user chooses it.
        position: rad, to either side; the reported position wraps here.
        speed: rad/s, to either side.
        torque: N m, to either side.
        kp: N m/rad, from 0.
        kd: N m s/rad, from 0.
        reply_lengths: bytes of a reply that this firmware sends; 6 without, 8 with temperature and fault.
        temperature_offset: degrees Celsius that are subtracted from the temperature byte. Sources disagree between 0
            and 40; 0 reads too warm rather than too cold.
        faults: fault byte -> name.
        source: where the ranges are printed.
    """

    name: str
    position: float
    speed: float
    torque: float
    kp: float
    kd: float
    source: str
    reply_lengths: tuple[int, ...] = (6, 8)
    temperature_offset: float = 0.0
    faults: Mapping[int, str] = field(default_factory=lambda: FAULT_NAMES)

    def fault_name(self, code: int) -> str:
        """Name of a fault byte; an unknown code is named by its number, never taken for none."""
        return "none" if code == 0 else self.faults.get(code, f"unknown fault {code}")


AK70_10_V1_0_8 = FirmwareProfile("ak70_10_v1_0_8", 12.5, 50.0, 25.0, 500.0, 5.0, "AK series manual V1.0.8, MIT mode")
AK70_10_24_N_M = FirmwareProfile("ak70_10_24_n_m", 12.5, 50.0, 24.0, 500.0, 5.0, "public driver, AK70-10 V1.1")
AK70_10_24_8_N_M = FirmwareProfile("ak70_10_24_8_n_m", 12.5, 50.0, 24.8, 500.0, 5.0, "peak torque of the data sheet")
MANUAL_SAMPLE_CODE = FirmwareProfile(
    "manual_sample_code", 95.5, 30.0, 18.0, 500.0, 5.0, "sample code of the AK series manual", reply_lengths=(6,)
)

PROFILES: Mapping[str, FirmwareProfile] = MappingProxyType(
    {profile.name: profile for profile in (AK70_10_V1_0_8, AK70_10_24_N_M, AK70_10_24_8_N_M, MANUAL_SAMPLE_CODE)}
)


def firmware_profile(name: str) -> FirmwareProfile:
    """The profile of that name.

    Raises:
        HardwareError: unknown name; lists the known ones, and refuses V3 firmware by name.
    """
    if "v3" in name.lower():
        raise HardwareError(
            f"firmware profile {name!r}: V3 firmware speaks another protocol (extended ids) and is not supported; "
            f"allowed: {', '.join(PROFILES)}"
        )
    if name not in PROFILES:
        raise HardwareError(f"firmware profile {name!r} is unknown; allowed: {', '.join(PROFILES)}")
    return PROFILES[name]
