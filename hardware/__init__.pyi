"""What `aerodima.hardware` promises; the modules behind it may move."""

from .car.car_ports import EVENTS_FILE as EVENTS_FILE
from .car.car_ports import PORTS_FILE as PORTS_FILE
from .car.car_ports import READY_FILE as READY_FILE
from .car.car_ports import CarPorts as CarPorts
from .car.car_ports import read_ports as read_ports
from .car.wiring import CarCommand as CarCommand
from .car.wiring import CarReading as CarReading
from .drive.car_guard import CarGuard as CarGuard
from .drive.drive_diagram import CarInterface as CarInterface
from .drive.drive_session import DriveOptions as DriveOptions
from .drive.drive_session import run_drive as run_drive
from .drive.held_car import connect as connect
from .drive.held_car import held as held
from .drive.held_car import run_cycles as run_cycles
from .emulator.fault_script import read_events as read_events
from .protocol.ak70 import FirmwareProfile as FirmwareProfile
from .protocol.ak70 import MitCommand as MitCommand
from .protocol.ak70 import decode_command as decode_command
from .protocol.ak70 import make_command as make_command
