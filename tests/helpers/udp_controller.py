"""A controller by UDP in Python, written from docs/wire-formats.md alone, and a line to it."""

import hmac
import struct

from telepresence.haptics.udp_protocol import UdpRole, UdpSession

MS = 1_000_000
KEY = bytes(range(32))


def code(body, key):
    return hmac.digest(key, body, "sha256")[:16]


class PythonController:
    """A mass of 1 kg per axis, or a handle that the test holds.

    answers: whether it is there. position, speed, push: per axis. detail: contact 1, dead man 2.
    state, force, leds: of the newest command.
    """

    def __init__(self, key=bytes(32), *, limits=(25.0, 0.5, 0.0, 0.0, 0.0), half=(0.15, 0.1)):
        self.key = key
        self.capabilities = struct.pack(">5fBB2f", *limits, 4, 4, *half) + b"test"
        self.takes, self.axes = 0, 2
        self.answers = True
        self.restart()

    def restart(self):
        """Begin a new start."""
        self.keys = self.pending = (None, None)
        self.newest = self.sent = self.lives = 0
        self.position, self.speed, self.push = [0.0, 0.0], [0.0, 0.0], [0.0, 0.0]
        self.state = self.detail = self.buttons = self.leds = self.error = 0
        self.text = b""
        self.force = [0.0, 0.0]
        self.nonce = 0

    def handle(self, datagram):
        """Return the answers to a datagram."""
        if not self.answers:
            return []
        kind, body = datagram[1], datagram[:-16]
        if kind == 1:
            assert code(body, self.key) == datagram[-16:] and len(datagram) == 36
            self.nonce += 1
            both = datagram[4:20] + self.nonce.to_bytes(16, "big")
            self.pending = tuple(
                hmac.digest(self.key, word + both, "sha256") for word in (b"command", b"reading")
            )
            body = bytes([1, 2, self.axes, self.takes]) + both + self.capabilities
            return [body + code(body, self.key)]
        assert kind == 3
        if self.keys[0] is None or code(body, self.keys[0]) != datagram[-16:]:
            if self.pending[0] is None or code(body, self.pending[0]) != datagram[-16:]:
                return []
            self.keys, self.newest, self.sent = self.pending, 0, 0
        number, self.leds, _, fx, _, _, fy, _, _ = struct.unpack(">QHH6f", body[4:])
        if number <= self.newest:
            return []
        self.newest, self.state, self.force = number, datagram[3], [fx, fy]
        if self.state == 2:
            for axis in (0, 1):
                self.speed[axis] += self.force[axis] * 1e-3
                self.position[axis] += self.speed[axis] * 1e-3
        else:
            self.speed = [0.0, 0.0]
        return [self.reading()]

    def reading(self):
        self.sent += 1
        body = bytes([1, 4, 2, self.detail]) + struct.pack(
            ">QQHHf6f",
            self.sent,
            self.newest,
            self.buttons,
            self.error,
            float("nan"),
            *(self.position[0], self.speed[0], self.push[0]),
            *(self.position[1], self.speed[1], self.push[1]),
        )
        body += self.text
        return body + code(body, self.keys[1])


class MemoryLine:
    """In the place of `UdpLine`: one cycle of 1 ms passes with each `send`."""

    def __init__(self, role, controller, *, key=bytes(32), seed=bytes(32)):
        self.session = UdpSession(role, key=key, seed=seed)
        self.controller = controller
        self.now_ns = 0
        self.sent, self.came = [], []
        self.closed = False

    def connect(self):
        for _ in range(2000):
            self.send()
            self.receive()
            if not self.session.silent:
                return self.session.capabilities
        return None

    def send(self):
        self.now_ns += MS
        datagram = self.session.poll_transmit(self.now_ns)
        if datagram is not None:
            self.sent.append(datagram)
            self.came += self.controller.handle(datagram)

    def receive(self):
        came, self.came = self.came, []
        for datagram in came:
            self.session.handle_datagram(datagram)

    def close(self):
        self.send()
        self.closed = True


def connected():
    """A line to a robot's controller with a key, after their handshake."""
    line = MemoryLine(UdpRole.ROBOT, PythonController(KEY), key=KEY)
    assert line.connect() is not None
    return line
