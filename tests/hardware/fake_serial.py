"""A serial link in memory, on a clock that the test turns."""


class FakeLink:
    """Stands where a `SerialLink` stands.

    Attributes:
        now: s; arrival of what comes in.
        answer: called with each piece that is written; returns the bytes that come back.
        sent: pieces that were written.
    """

    def __init__(self, answer=lambda data: b""):
        self.now = 50.0
        self.answer = answer
        self.sent = []
        self.fault = self.error = ""
        self.losses = 0
        self._inbox = []

    def write(self, data):
        self.sent.append(data)
        self.deliver(self.answer(data))

    def deliver(self, data):
        self._inbox.append((self.now, data))

    def poll(self):
        inbox = self._inbox
        self._inbox = []
        return inbox

    def flush(self, timeout=0.2):
        return True
