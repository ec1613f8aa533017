"""Roll angle and rate of the car from its IMU's reports, as a Drake system on `roll_filter`."""

from pydrake.systems.framework import Context, DiagramBuilder, DiscreteValues, LeafSystem, System

from aerodima.workbench.car.roll_filter import RollEstimate, RollFilterSettings, estimate_roll
from aerodima.workbench.core.event_order import EventPriority, declare_ticks, priority_before
from aerodima.workbench.core.port_wiring import DiscreteVector, add_and_connect, vector_of
from aerodima.workbench.scenario.signal_table import IMU, SPEED


class RollEstimator(LeafSystem):
    """Complementary filter on the IMU's reported signals (`estimate_roll`), run at a fixed rate,
    held in between.

    Input ports:
        imu (9): signals of the IMU from the station, `signal_table.IMU`.
        speed (1): speed from the station, m/s.
    Output ports:
        roll_estimate (1): estimated roll, rad, positive to the right.
        roll_rate_estimate (1): estimated roll rate, rad/s.

    Args:
        settings: settings of the filter; its rate should be the IMU's.
        stage: stage of the ticks beside a simulated car (`aerodima.workbench.core.event_order`).
    """

    def __init__(
        self, settings: RollFilterSettings | None = None, stage: EventPriority | None = None
    ) -> None:
        super().__init__()
        self.set_name("roll_estimator")
        self._settings = settings or RollFilterSettings()
        self._imu = self.DeclareVectorInputPort("imu", IMU.size)
        self._speed = self.DeclareVectorInputPort("speed", SPEED.size)
        self._roll = DiscreteVector(self, [0.0], output="roll_estimate")
        self._roll_rate = DiscreteVector(self, [0.0], output="roll_rate_estimate")
        self._filter = DiscreteVector(self, RollEstimate())
        declare_ticks(self, self._settings.rate, stage, self._tick)

    @classmethod
    def add_to_builder(
        cls, builder: DiagramBuilder, settings: RollFilterSettings | None = None, *, station: System
    ) -> "RollEstimator":
        """Adds an estimator and connects it to the outputs `imu` and `speed` of a station."""
        estimator = cls(settings, priority_before(station, EventPriority.CONTROLLER))
        return add_and_connect(
            builder,
            estimator,
            imu=station.GetOutputPort("imu"),
            speed=station.GetOutputPort("speed"),
        )

    def _tick(self, context: Context, discrete_state: DiscreteValues) -> None:
        before = RollEstimate(*self._filter.read(context).tolist())
        imu = vector_of(self._imu, context)
        speed = vector_of(self._speed, context)
        after = estimate_roll(before, imu, float(speed[0]), self._settings)
        self._filter.write(discrete_state, after)
        self._roll.write(discrete_state, [after.roll])
        self._roll_rate.write(discrete_state, [after.roll_rate])
