"""A CAN adapter made of queues with failures that are switched on, and a slcan adapter on a
pseudo-terminal.
"""

import os
import pty
import queue
import threading
import time
import tty

import can


class FakeAdapter(can.BusABC):
    """Stands where python-can's driver stands."""

    def __init__(self):
        super().__init__(channel="fake")
        self._can_protocol = can.CanProtocol.CAN_20
        self.channel_info = "fake adapter"
        self.incoming: queue.Queue = queue.Queue()
        self.outgoing: list[can.Message] = []
        self.send_error: Exception | None = None
        self.send_gate = threading.Event()
        self.send_gate.set()
        self.echo = False
        self.closed = False

    def deliver(self, arbitration_id, data, extended=False, **flags):
        message = can.Message(
            arbitration_id=arbitration_id, data=data, is_extended_id=extended, **flags
        )
        self.incoming.put(message)

    def _recv_internal(self, timeout):
        try:
            item = self.incoming.get(timeout=timeout)
        except queue.Empty:
            return None, False
        if isinstance(item, BaseException):
            raise item
        return item, False

    def send(self, msg, timeout=None):
        self.send_gate.wait()
        if self.send_error is not None:
            raise self.send_error
        self.outgoing.append(msg)
        if self.echo:
            self.deliver(msg.arbitration_id, bytes(msg.data))

    def shutdown(self):
        super().shutdown()
        self.closed = True


class SlcanAdapter:
    """The far side of a serial CAN adapter: lines in, lines out, over a pseudo-terminal."""

    def __init__(self, on_frame=None):
        self.master, slave = pty.openpty()
        tty.setraw(self.master)
        tty.setraw(slave)
        self.path = os.ttyname(slave)
        self._slave = slave
        self._on_frame = on_frame
        self.lines: list[bytes] = []
        self._running = True
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def frames(self):
        """(id, data) of the frames that the computer sent."""
        return [
            (int(line[1:4], 16), bytes.fromhex(line[5:].decode()))
            for line in list(self.lines)
            if line[:1] == b"t"
        ]

    def write(self, data: bytes):
        os.write(self.master, data)

    def deliver(self, arbitration_id, data):
        self.write(f"t{arbitration_id:03X}{len(data)}{data.hex().upper()}\r".encode())

    def unplug(self):
        """Pulls the plug: the computer's end reads an error from now on."""
        self._running = False
        self._thread.join(1.0)
        os.close(self.master)
        os.close(self._slave)

    def _serve(self):
        buffer = b""
        os.set_blocking(self.master, False)
        while self._running:
            try:
                buffer += os.read(self.master, 4096)
            except BlockingIOError:
                time.sleep(0.0005)
                continue
            except OSError:
                return
            *lines, buffer = buffer.split(b"\r")
            for line in lines:
                self.lines.append(line)
                if line[:1] == b"t" and self._on_frame is not None:
                    self._on_frame(int(line[1:4], 16), bytes.fromhex(line[5:].decode()))


def wait_until(condition, timeout=10.0):
    """Whether `condition()` came true within `timeout` s."""
    end = time.monotonic() + timeout
    while time.monotonic() < end:
        if condition():
            return True
        time.sleep(0.001)
    return bool(condition())
