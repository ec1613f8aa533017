"""What `aerodima.hardware` promises; the modules behind it may move."""

from .car.car_ports import EVENTS_FILE as EVENTS_FILE
from .car.car_ports import PORTS_FILE as PORTS_FILE
from .car.car_ports import READY_FILE as READY_FILE
from .car.wiring import CarCommand as CarCommand
from .drive.held_car import connect as connect
from .drive.held_car import held as held
from .drive.held_car import run_cycles as run_cycles
from .emulator.fault_script import read_events as read_events
from .protocol.ak70 import FirmwareProfile as FirmwareProfile
from .protocol.ak70 import MitCommand as MitCommand
from .protocol.ak70 import decode_command as decode_command
from .protocol.ak70 import make_command as make_command
