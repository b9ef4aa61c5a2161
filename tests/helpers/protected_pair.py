"""Two protected channels on virtual time, and a path between them that can fail in any way."""

import heapq
from random import Random

from telepresence.link.protection.channel import ProtectedChannel, SessionBegun
from telepresence.link.protection.identity import MachineKey

MS = 1_000_000
S = 1000 * MS
GROUND_ADDRESS = ("192.0.2.1", 27000)
SPACE_ADDRESS = ("198.51.100.2", 27000)
GROUND_KEY = MachineKey.from_seed(bytes(32))
SPACE_KEY = MachineKey.from_seed(bytes([1] * 32))


class ProtectedEnd:
    """A channel that sends a numbered frame in each slot, as a gateway does."""

    def __init__(self, key, peer, address, peer_address, **options):
        self.key, self.peer, self.address = key, peer, address
        self.peer_address, self.options = peer_address, options
        self.channel = None
        self.starts = 0
        self.frames_sent = 0
        #: Numbers of the frames that were sealed, and of those that came: with repetitions.
        self.sealed = []
        self.got = []
        self.received = 0
        self.events = []

    def start(self, now_ns):
        self.starts += 1
        self.received = 0
        self.channel = ProtectedChannel(
            self.key,
            self.peer,
            secret=bytes([self.starts, len(self.address[0])]) * 16,
            address=self.peer_address,
            now_ns=now_ns,
            **self.options,
        )

    def of(self, kind):
        return [event for event in self.events if isinstance(event, kind)]

    @property
    def dropped(self):
        return {name: n for name, n in self.channel.metrics.dropped.items() if n}


class ProtectedPair:
    """Both ends, and a path with delay, loss, repetitions and reordering.

    lost, repeated: shares of the datagrams. jitter_ns: the largest further delay.
    """

    def __init__(self, *, seed=1, lost=0.0, repeated=0.0, jitter_ns=0, delay_ns=10 * MS, **options):
        self.random = Random(seed)
        #: May be changed at any time.
        self.lost, self.repeated = lost, repeated
        self.jitter_ns, self.delay_ns = jitter_ns, delay_ns
        self.slot_ns = 5 * MS
        self.now_ns = 0
        self.space_called = options.pop("space_called", False)
        self.ground = ProtectedEnd(
            GROUND_KEY,
            SPACE_KEY.identity,
            GROUND_ADDRESS,
            None if self.space_called else SPACE_ADDRESS,
            **options,
        )
        self.space = ProtectedEnd(
            SPACE_KEY, GROUND_KEY.identity, SPACE_ADDRESS, GROUND_ADDRESS, **options
        )
        #: Ends beside the two.
        self.unknown_senders = []
        self.path = []
        #: Every datagram that an end sent: (from, datagram).
        self.recorded = []
        self.count = 0
        #: Says of an end's datagram whether it is lost, besides `lost`.
        self.blocks = lambda end, datagram: False

    @property
    def ends(self):
        return self.ground, self.space

    def send(self, end, datagram, address):
        self.recorded.append((end, datagram))
        if self.blocks(end, datagram):
            return
        copies = 0 if self.random.random() < self.lost else 1
        copies += self.random.random() < self.repeated
        for _ in range(copies):
            self.inject(
                datagram,
                end.address,
                address,
                self.delay_ns + self.random.randrange(self.jitter_ns + 1),
            )

    def inject(self, datagram, source, address, delay_ns=0):
        self.count += 1
        heapq.heappush(self.path, (self.now_ns + delay_ns, self.count, datagram, source, address))

    def run(self, seconds):
        until_ns = self.now_ns + round(seconds * S)
        while self.now_ns < until_ns:
            self.step()
        return self

    def step(self):
        while self.path and self.path[0][0] <= self.now_ns:
            _, _, datagram, source, address = heapq.heappop(self.path)
            for end in (*self.ends, *self.unknown_senders):
                if end.address == address and end.channel is not None:
                    end.received += 1
                    frame = end.channel.handle_datagram(datagram, source, self.now_ns)
                    if frame is not None:
                        end.got.append(int(frame))
                    self.drain(end)
        for end in (*self.ends, *self.unknown_senders):
            channel = end.channel
            if channel is None:
                continue
            for _ in range(20):
                due = channel.poll_timeout()
                if due is None or due > self.now_ns:
                    break
                channel.handle_timeout(self.now_ns)
                self.drain(end)
            else:
                raise AssertionError("a timeout that never ends")
            end.frames_sent += 1
            sealed = channel.seal(b"%d" % end.frames_sent, self.now_ns)
            if sealed is not None:
                end.sealed.append(end.frames_sent)
                self.send(end, sealed, channel.peer_address)
            self.drain(end)
        self.now_ns += self.slot_ns

    def drain(self, end):
        while (found := end.channel.poll_transmit()) is not None:
            self.send(end, *found)
        while (event := end.channel.next_event()) is not None:
            end.events.append(event)

    def start(self):
        self.ground.start(self.now_ns)
        self.space.start(self.now_ns)
        return self


def connected(**options):
    pair = ProtectedPair(**options).start()
    while not all(end.of(SessionBegun) for end in pair.ends):
        pair.run(0.1)
        assert pair.now_ns < 20 * S
    return pair.run(0.1)
