"""What `aerodima.hardware` promises; the modules behind it may move."""

from .car.wiring import CarCommand as CarCommand
from .console.emulated_car import emulated_car as emulated_car
from .driving.drive_session import drive as drive
from .driving.held_car import connect as connect
from .driving.held_car import held as held
from .driving.held_car import holding as holding
from .driving.held_car import run_cycles as run_cycles
from .protocol.ak70 import FirmwareProfile as FirmwareProfile
from .protocol.ak70 import MitCommand as MitCommand
from .protocol.ak70 import decode_command as decode_command
from .protocol.ak70 import make_command as make_command
