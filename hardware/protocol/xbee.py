"""API frames of XBee modules, as far as the operator's radio needs them: data received, data to
send.

The modules are in API mode 1. A frame is 7E, two bytes of length, the content and a checksum: FF
minus the sum of the content. Content `90` is data that arrived: sender 8 bytes, network
address 2, options 1, data. Content `10` is data to send: frame id 1 (0: no answer wanted), receiver
8, network address 2, radius 1, options 1, data.
"""

import struct
from dataclasses import dataclass

from aerodima.hardware.protocol.byte_stream import cut_frames
from aerodima.hardware.protocol.can_frame import check_field

START = 0x7E
"""First byte of a frame."""
_RECEIVED = 0x90
"""First byte of the content: data that arrived."""
_TRANSMIT = 0x10
"""First byte of the content: data to send."""
_RECEIVED_HEAD = struct.Struct(">BQHB")
"""Kind, sender, network address and options before the data that arrived."""
_TRANSMIT_HEAD = struct.Struct(">BBQHBB")
"""Kind, frame id, receiver, network address, radius and options before the data to send."""
_MAX_CONTENT = 128
"""Longest content of a frame, bytes."""
_UNKNOWN_NETWORK_ADDRESS = 0xFFFE
BROADCAST = 0xFFFF
"""Address of every module: a broadcast."""


@dataclass(frozen=True, slots=True)
class Packet:
    """Data that another module sent, or that is for it.

    Attributes:
        address: 64-bit serial number of that module.
        data: data bytes, without the frame around them.
    """

    address: int
    data: bytes


def make_transmit(data: bytes, receiver: int) -> bytes:
    """Makes the frame that sends data to the module with the serial number `receiver`, without an
    answer.

    Raises:
        FrameError: more data than a frame carries.
    """
    head = _TRANSMIT_HEAD.pack(_TRANSMIT, 0, receiver, _UNKNOWN_NETWORK_ADDRESS, 0, 0)
    return _frame(head + data)


def make_received(packet: Packet) -> bytes:
    """Makes the frame that a module hands over for data that arrived; for emulators."""
    head = _RECEIVED_HEAD.pack(_RECEIVED, packet.address, _UNKNOWN_NETWORK_ADDRESS, 1)
    return _frame(head + packet.data)


class ApiStream:
    """Parser of the packets in a serial stream that begins anywhere and may carry noise.

    A frame whose checksum is wrong is dropped, and the search goes on behind its first byte: a
    start byte within noise costs no good frame. Frames of other kinds (modem status, ...) are
    skipped.
    """

    def __init__(self) -> None:
        self._open = b""

    def feed(self, data: bytes) -> list[Packet]:
        """Adds bytes; returns the packets that arrived and became complete, oldest first."""
        return self._packets(data, _RECEIVED, 1, _RECEIVED_HEAD.size)

    def feed_transmits(self, data: bytes) -> list[Packet]:
        """Adds bytes that a computer hands to its module, for emulators; returns the packets."""
        return self._packets(data, _TRANSMIT, 2, _TRANSMIT_HEAD.size)

    def _packets(self, data: bytes, kind: int, place: int, head: int) -> list[Packet]:
        """Returns the packets of one kind: `place` is that of the address in the content, and
        `head` the number of bytes before the data.
        """
        contents, self._open = cut_frames(self._open + data, bytes([START]), _cut)
        return [
            Packet(int.from_bytes(content[place : place + 8], "big"), content[head:])
            for content in contents
            if content[0] == kind and len(content) >= head
        ]


def _cut(data: bytes) -> tuple[int, bytes | None]:
    if len(data) < 3:
        return 0, None
    length = int.from_bytes(data[1:3], "big")
    possible = 0 < length <= _MAX_CONTENT
    if possible and len(data) < length + 4:
        return 0, None
    content = data[3 : 3 + length]
    if not possible or sum(content) + data[3 + length] & 0xFF != 0xFF:
        return 1, None
    return length + 4, content


def _frame(content: bytes) -> bytes:
    check_field("XBee frame length", len(content), 0, _MAX_CONTENT, "bytes")
    body = len(content).to_bytes(2, "big") + content + bytes([0xFF - sum(content) % 256])
    return bytes([START]) + body
