"""What `aerodima.hardware` promises; the modules behind it may move."""

from .car.car_ports import CarPorts as CarPorts
from .car.car_ports import read_ports as read_ports
from .car.emulator_files import EVENTS_FILE as EVENTS_FILE
from .car.emulator_files import PORTS_FILE as PORTS_FILE
from .car.emulator_files import READY_FILE as READY_FILE
from .car.wiring import CarCommand as CarCommand
from .car.wiring import CarReading as CarReading
from .drive.car_guard import CarGuard as CarGuard
from .drive.car_interface import CarInterface as CarInterface
from .drive.drive_session import DriveOptions as DriveOptions
from .drive.drive_session import run_drive as run_drive
from .drive.held_car import connect as connect
from .drive.held_car import held as held
from .drive.held_car import run_cycles as run_cycles
from .emulator.event_log import read_events as read_events
from .protocol.ak70 import MitCommand as MitCommand
from .protocol.ak70 import decode_command as decode_command
from .protocol.ak70 import make_command as make_command
from .protocol.ak70_profiles import FirmwareProfile as FirmwareProfile
