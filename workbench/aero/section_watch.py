"""A watch on the sections of a `TailForce` during a run."""

import numpy as np
from pydrake.systems.framework import Context, EventStatus, LeafSystem

from aerodima.workbench.core.event_order import EventPriority, period_of
from aerodima.workbench.core.port_wiring import vector_of

SECTION_COLUMNS = ("relative_speed_m_per_s", "angle_of_attack_rad", "reynolds_number", "force_n")
"""Columns of each section in the port `sections` of a `TailForce`."""
NOT_EXPOSED = 0.0
"""Validity of a section that is not exposed to the air."""
MEASURED = 1.0
"""Validity of a section inside the range of its measured coefficients."""
EXTRAPOLATED = 2.0
"""Validity of a section outside that range."""
BEYOND_QUASI_STEADY = 3.0
"""Validity of a section faster than the quasi-steady law is meant for."""
_REYNOLDS = SECTION_COLUMNS.index("reynolds_number")
_SPEED = SECTION_COLUMNS.index("relative_speed_m_per_s")
_FORCE = SECTION_COLUMNS.index("force_n")
_STILL_AIR = 0.1
"""Air slower than this (m/s) is not expected to show a force."""
_ROUNDING = 1e-12
"""Force over speed squared, N per (m/s)2, that rounding leaves of a plate along the flow."""


class SectionWatch(LeafSystem):
    """Counts the looks at which a section was outside its coefficients' range; keeps the largest
    Reynolds number.

    The counts are those of one run: initialisation starts them anew.

    Input ports:
        sections (4 n), validity (n): as the ports of these names of a `TailForce`.

    Attributes:
        fastest: largest relative speed of a section so far, m/s.

    Args:
        number: number of sections, n.
        rate: rate of the looks, Hz.
    """

    def __init__(self, number: int, rate: float) -> None:
        super().__init__()
        self._sections = self.DeclareVectorInputPort("sections", len(SECTION_COLUMNS) * number)
        self._validity = self.DeclareVectorInputPort("validity", number)
        self._clear()
        self.DeclareInitializationPublishEvent(self._start)
        self.DeclarePeriodicPublishEvent(period_of(rate, EventPriority.RECORD), 0.0, self._look)

    def facts(self) -> dict[str, float]:
        """Sums up the run so far, for `extra` of its log.

        Returns:
            sections_outside_measured_range: share of the looks (0 to 1) at which at least one
                section held the edge value of its coefficients.
            sections_above_quasi_steady_limit: share of the looks at which at least one section,
                inside that range, was faster than the quasi-steady model was shown to hold.
            largest_reynolds_number: largest Reynolds number of any section, with the sail's width.
        """
        looks = max(self._looks, 1)
        return {
            "sections_outside_measured_range": self._outside / looks,
            "sections_above_quasi_steady_limit": self._too_fast / looks,
            "largest_reynolds_number": self._reynolds,
        }

    @property
    def felt_no_air(self) -> bool:
        """Tells whether air passed the sections and none of them felt a force above rounding."""
        return self.fastest > _STILL_AIR and self._share <= _ROUNDING

    def _clear(self) -> None:
        self._looks = 0
        self._outside = 0
        self._too_fast = 0
        self._reynolds = 0.0
        self.fastest = 0.0
        self._share = 0.0

    def _start(self, context: Context) -> EventStatus:
        self._clear()
        return EventStatus.Succeeded()

    def _look(self, context: Context) -> EventStatus:
        sections = vector_of(self._sections, context)
        validity = vector_of(self._validity, context)
        self._looks += 1
        self._outside += bool(np.any(validity == EXTRAPOLATED))
        self._too_fast += bool(np.any(validity == BEYOND_QUASI_STEADY))
        columns = len(SECTION_COLUMNS)
        speeds = sections[_SPEED::columns]
        shares = sections[_FORCE::columns] / np.maximum(speeds, _STILL_AIR) ** 2
        self._reynolds = max(self._reynolds, float(sections[_REYNOLDS::columns].max()))
        self.fastest = max(self.fastest, float(speeds.max()))
        self._share = max(self._share, float(np.max(shares)))
        return EventStatus.Succeeded()
