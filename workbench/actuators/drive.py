"""Brushless drive on the rear differential (design section 6)."""

from aerodima.workbench.config.car_parameters import CarParameters, DriveParameters


def steady_speed(throttle: float, drive: DriveParameters) -> float:
    """Speed (m/s) for a throttle in -1..1: the fitted line, mirrored for reverse, zero inside its dead band.

    Without governor the motor does not overcome its load below `breakaway_throttle` (thesis 6.2).
    """
    if not drive.governor and abs(throttle) < drive.breakaway_throttle:
        return 0.0
    forward = max(0.0, drive.throttle_gain * abs(throttle) + drive.throttle_offset)
    return forward if throttle > 0 else -forward if throttle < 0 else 0.0


def shaft_gain(drive: DriveParameters, car: CarParameters) -> float:
    """Torque per shaft-speed error, N m s/rad: the governor's, or the motor's own from the car's speed response."""
    if drive.governor:
        return drive.governor_gain
    return (car.mass * car.tyre_radius**2 + drive.rotor_inertia) / drive.time_constant


def shaft_torque(throttle: float, shaft_speed: float, drive: DriveParameters, gain: float, radius: float) -> float:
    """Torque (N m) on the differential's shaft: clip(k (w_target - w), +-limit).

    The throttle sets the target through the line of section 6.2. With governor k is stiff, so the wheel speed is held
    through the turn; without, k is the slope of the motor's torque-speed line and the speed droops with load. At
    throttle 0 the drive is off and rolls freely. NaN counts as throttle 0; beyond +-1 is clipped.

    Args:
        throttle: -1..1.
        shaft_speed: rad/s, positive forward.
        drive: line, torque limit.
        gain: k, N m s/rad, from `shaft_gain`.
        radius: m, of the loaded rear tyres as they roll.
    """
    if throttle != throttle or throttle == 0.0:
        return 0.0
    target = steady_speed(min(max(throttle, -1.0), 1.0), drive) / radius
    limit = drive.torque_limit
    return min(max(gain * (target - shaft_speed), -limit), limit)
