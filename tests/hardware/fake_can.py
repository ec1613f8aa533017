"""A CAN adapter made of queues with failures that are switched on."""

import queue
import threading
import time

import can


class FakeAdapter(can.BusABC):
    """Stands where python-can's driver stands."""

    def __init__(self):
        super().__init__(channel="fake")
        self._can_protocol = can.CanProtocol.CAN_20
        self.channel_info = "fake adapter"
        self.incoming = queue.Queue()
        self.outgoing = []
        self.send_error = None
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


def wait_until(condition, timeout=10.0):
    """Whether `condition()` came true within `timeout` s."""
    end = time.monotonic() + timeout
    while time.monotonic() < end:
        if condition():
            return True
        time.sleep(0.001)
    return bool(condition())
