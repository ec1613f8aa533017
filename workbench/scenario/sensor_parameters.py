"""The sensors of a scenario."""

from aerodima.workbench.core.quantity import QuantityModel, quantity


class ImuParameters(QuantityModel):
    """BNO055 inertial measurement unit."""

    rate: float = quantity("Hz", "sampling rate", "(0, 10000]")
    delay: float = quantity("s", "age of a sample when it appears", "[0, 1]")
    x: float = quantity("m", "position ahead of the rear axle", "[-1, 1]")
    z: float = quantity("m", "height above the ground", "[0, 1]")
    gyro_noise: float = quantity("rad/s", "standard deviation of a gyro sample", "[0, 10]")
    gyro_bias: float = quantity(
        "rad/s", "standard deviation of the constant bias of a run", "[0, 10]"
    )
    accelerometer_noise: float = quantity(
        "m/s2", "standard deviation of an acceleration sample", "[0, 100]"
    )
    attitude_noise: float = quantity("rad", "standard deviation of an attitude sample", "[0, 1]")


class GpsParameters(QuantityModel):
    """Ground speed from the C94-M8P receiver."""

    rate: float = quantity("Hz", "sampling rate", "(0, 1000]")
    delay: float = quantity("s", "age of a sample when it appears", "[0, 5]")
    noise: float = quantity("m/s", "standard deviation of a speed sample", "[0, 10]")


class SailEncoderParameters(QuantityModel):
    """Absolute encoder of the sail joint, at the microcontroller (thesis 5.4.5; ERRATA E30)."""

    rate: float = quantity("Hz", "rate at which the reading reaches the station", "(0, 10000]")
    delay: float = quantity("s", "age of a sample when it appears", "[0, 1]")
    bits: int = quantity("1", "word length", "[4, 20]")
    noise: float = quantity(
        "rad", "standard deviation of the angle before quantisation", "[0, 0.1]"
    )
