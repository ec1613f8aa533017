"""Cars for tests that need a certain one: their numbers stay when the default car changes."""

HIGH_BODY = (
    "car.mass=6.87",
    "car.com_height=0.241",
    "car.com_x=0.104",
    "car.gyration_roll=0.118",
    "car.gyration_pitch=0.118",
    "car.gyration_yaw=0.141",
    "car.track=0.242",
    "car.suspension_motion_ratio=0.684",
    "car.tyre_friction=0.563",
    "car.tyre_slip_angle=0.0",
    "imu.x=0.0712",
    "imu.z=0.126",
    "tail.mount_height=0.235",
    "tail.roll_stop=1.5707963267948966",
    "controller.delay=0.0",
)
"""Overrides of a car on rigid tyres, its centre of mass high and far behind. Without a tail it
rolls over between 3.33 and 3.61 m/s, and without its board full throttle tips it backwards."""
HEAVY_TAIL = {"length": 0.82, "mass": 0.174, "sail_width": 0.0309}
"""Values of a built tail, m and kg."""
HIGH_CAR = (*HIGH_BODY, *(f"tail.{key}={value}" for key, value in HEAVY_TAIL.items()))
