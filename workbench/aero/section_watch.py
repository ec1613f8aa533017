"""Did the sail leave the conditions that its coefficients were measured in? Facts about a run, for its log."""

from __future__ import annotations

import numpy as np
from pydrake.systems.framework import Context, DiagramBuilder, EventStatus, LeafSystem, OutputPort

from aerodima.workbench.aero.tail_force import BEYOND_QUASI_STEADY, EXTRAPOLATED, SECTION_COLUMNS
from aerodima.workbench.systems.system_ports import Stage, connected, period_of, vector_of

_REYNOLDS = SECTION_COLUMNS.index("reynolds_number")
_SPEED, _FORCE = (SECTION_COLUMNS.index(name) for name in ("relative_speed_m_per_s", "force_n"))
_STILL_AIR = 0.1
"""m/s; slower air is not expected to show a force."""
_ROUNDING = 1e-12
"""N per (m/s)2: less is what rounding leaves of a plate along the flow."""


class SectionWatch(LeafSystem):
    """Counts the looks at which a section was outside its coefficients' range; keeps the largest Reynolds number.

    The counts are those of one run: initialisation starts them anew.

    Input ports:
        sections (4 n), validity (n): of a `TailForce`.

    Args:
        number: of sections.
        rate: looks per second, Hz.
    """

    def __init__(self, number: int, rate: float) -> None:
        super().__init__()
        self._sections = self.DeclareVectorInputPort("sections", len(SECTION_COLUMNS) * number)
        self._validity = self.DeclareVectorInputPort("validity", number)
        self._clear()
        self.DeclareInitializationPublishEvent(self._start)
        self.DeclarePeriodicPublishEvent(period_of(rate, Stage.RECORD), 0.0, self._look)

    @classmethod
    def add_to_builder(
        cls, builder: DiagramBuilder, name: str, sections: OutputPort, validity: OutputPort, rate: float
    ) -> SectionWatch:
        """Adds a watch, at `rate` Hz, on these ports of a `TailForce`."""
        return connected(builder, cls(validity.size(), rate), name, sections=sections, validity=validity)

    def facts(self) -> dict[str, float]:
        """What the run came to so far, for `extra` of its log.

        Returns:
            sections_outside_measured_range: share of the looks (0 to 1) at which at least one section held the edge
                value of its coefficients.
            sections_above_quasi_steady_limit: share at which at least one section, inside that range, was faster than
                the quasi-steady model was shown to hold.
            largest_reynolds_number: of any section, with the sail's width.
        """
        looks = max(self._looks, 1)
        return {
            "sections_outside_measured_range": self._outside / looks,
            "sections_above_quasi_steady_limit": self._too_fast / looks,
            "largest_reynolds_number": self._reynolds,
        }

    @property
    def fastest(self) -> float:
        """Largest relative speed of a section so far, m/s."""
        return self._fastest

    @property
    def felt_no_air(self) -> bool:
        """Whether air passed the sections and none of them ever felt more than rounding leaves of a force."""
        return self._fastest > _STILL_AIR and self._share <= _ROUNDING

    def _clear(self) -> None:
        self._looks = self._outside = self._too_fast = 0
        self._reynolds = self._fastest = self._share = 0.0

    def _start(self, context: Context) -> EventStatus:
        self._clear()
        return EventStatus.Succeeded()

    def _look(self, context: Context) -> EventStatus:
        sections = vector_of(self._sections, context)
        validity = vector_of(self._validity, context)
        self._looks += 1
        self._outside += bool(np.any(validity == EXTRAPOLATED))
        self._too_fast += bool(np.any(validity == BEYOND_QUASI_STEADY))
        speeds, forces = (sections[column :: len(SECTION_COLUMNS)] for column in (_SPEED, _FORCE))
        self._reynolds = max(self._reynolds, float(sections[_REYNOLDS :: len(SECTION_COLUMNS)].max()))
        self._fastest = max(self._fastest, float(speeds.max()))
        self._share = max(self._share, float(np.max(forces / np.maximum(speeds, _STILL_AIR) ** 2)))
        return EventStatus.Succeeded()
