"""A wiring in memory: a tail that follows its commands without mass, a yaw rate by the tick, faults
by hand.
"""

import math

import numpy as np

from aerodima.hardware.car.wiring import CarReading
from aerodima.hardware.devices.device_states import MotorFault, SourceFault
from aerodima.hardware.devices.radio_link import IDLE
from aerodima.hardware.protocol.radio import OperatorCommand, OperatorPrompt, RadioMode
from aerodima.workbench.core.errors import HardwareError
from aerodima.workbench.scenario.scenario import load_scenario
from aerodima.workbench.scenario.signal_table import STATUS, STATUS_SOURCES

PERIOD = 0.01


def quick_turn(**settings):
    """The AUTO sequence in two seconds: turn at 0.5 s for 0.5 s, throttle off at 1.2 s."""
    times = {
        "straight_time": 0.5,
        "speed_ramp": 0.3,
        "wait_after_turn": 0.2,
        "log_end": 2.0,
        **settings,
    }
    return load_scenario("auto_turn", [f"manoeuvre.{key}={value}" for key, value in times.items()])


class FakeWiring:
    """Attributes: commands: as exchanged; calls: of arm, hold, disarm, stop; faults: on the
    status by name;
    operator: what is chosen, by one who goes to IDLE first when the car asks for it, unless
    `stubborn`.
    """

    def __init__(self, roll=-math.pi / 2, yaw_rate=lambda tick: 0.0):
        self.name = "watched_can"
        self.roll = roll
        self.roll_rate = 0.0
        self.yaw_rate = yaw_rate
        self.attitude = (0.0, 0.0)
        self.lean = 0.0
        self.speed = 3.0
        self.imu_time = self.teensy_time = 0.0
        self.armed = False
        self.holds_pitch = False
        self.faults = {}
        self.ages = {}
        self.fault_text = ""
        self.fault_texts = {}
        self.operator = OperatorCommand(RadioMode.AUTO)
        self.prompt = OperatorPrompt.NONE
        self.stubborn = False
        self.commands = []
        self.calls = []
        self.refuse = ""
        self.raises = None

    def start(self):
        self.calls.append("start")

    def arm(self):
        if self.refuse:
            raise HardwareError(self.refuse)
        self.calls.append("arm")
        self.armed = True

    def hold(self, now, centred=False):
        self.calls.append("hold")

    def disarm(self, now):
        self.calls.append("disarm")
        self.armed = False

    def stop(self, reason):
        self.calls.append("stop")
        self.armed = False

    def set_fault(self, source, code, text):
        self.faults[source] = code
        self.fault_texts[source] = text

    def motor_fault(self, joint="roll", code=MotorFault.NO_REPLY):
        """As `MotorGroup` does it: both motors are off with it, but for a pitch motor that is
        held.
        """
        other = {"roll": "pitch", "pitch": "roll"}[joint]
        self.faults[f"tail_{joint}"] = code
        if joint == "pitch" or not self.holds_pitch:
            self.faults[f"tail_{other}"] = MotorFault.OTHER_MOTOR
        self.fault_text = f"tail {joint}: no reply for 5 cycles"
        self.armed = False

    def write(self, command, now):
        self.commands.append(command)
        position, velocity, kp, kd, _ = command.tail_roll
        if self.armed and (kp or kd):
            self.roll_rate = velocity if kp == 0 else 10.0 * (position - self.roll)
            self.roll = min(1.6, max(-1.6, self.roll + PERIOD * self.roll_rate))

    def read(self, now):
        if self.raises is not None:
            raise self.raises
        obeys = self.prompt is OperatorPrompt.RETURN_TO_IDLE and not self.stubborn
        imu = np.zeros(9)
        imu[:2] = self.attitude
        imu[2] = math.remainder(3.0 + 0.05 * len(self.commands), 2 * math.pi)
        imu[5] = self.yaw_rate(len(self.commands))
        status = {f"{source}_age": self.ages.get(source, 0.004) for source in STATUS_SOURCES}
        status |= {name.replace("_age", "_fault"): 0.0 for name in status}
        status |= {f"{source}_fault": float(code) for source, code in self.faults.items()}
        return CarReading(
            tail_state=np.array([0.0, self.roll, 0.1, 0.0, self.roll_rate, 0.0]),
            imu=imu,
            speed=np.array([self.speed]),
            status=STATUS.write(**status, armed=float(self.armed)),
            lean=self.lean,
            fault_texts=self.fault_texts,
            operator=IDLE if obeys else self.operator,
            fault_text=self.fault_text
            or next((f"{name} {SourceFault(code).name}" for name, code in self.faults.items()), ""),
        )
