"""Two ends of the services with local programs in memory, and a bad link between them."""

from random import Random

from kontur_av.clock import NS_PER_MS, NS_PER_S
from telepresence.services.streams import ServiceStreams, StreamClosed, StreamEnded, StreamOpened


class LocalProgram:
    """What a local connection of a stream wrote and read."""

    def __init__(self) -> None:
        #: To be written, and whether the connection ends after it.
        self.pending, self.wrote, self.ends = b"", b"", False
        self.read, self.ended = b"", False
        self.closed, self.reason = False, None
        #: Takes nothing while it is False.
        self.reads = True
        self._end_said = False

    def write(self, octets: bytes, *, ends: bool = False) -> None:
        self.pending += octets
        self.ends = self.ends or ends

    def work(self, token: int, streams: ServiceStreams, now_ns: int) -> None:
        if room := min(streams.room_octets(token), len(self.pending)):
            octets, self.pending = self.pending[:room], self.pending[room:]
            self.wrote += octets
            streams.handle_data(token, octets, now_ns)
        if self.ends and not self.pending and not self._end_said:
            self._end_said = True
            streams.handle_end(token)
        if self.reads and (octets := streams.received(token)):
            assert not self.ended
            self.read += octets
            streams.handle_taken(token, len(octets), now_ns)


class ServiceEnd:
    """Streams and their programs; `restart` it as if its process had been killed."""

    def __init__(self, seed: int, now_ns: int = 0, rate_bps: int = 200_000) -> None:
        self._random, self._rate_bps = Random(seed), rate_bps
        self.programs: dict[int, LocalProgram] = {}
        self.restart(now_ns)

    def restart(self, now_ns: int) -> None:
        for program in self.programs.values():
            program.closed = True
        self.programs = {}
        self.streams = ServiceStreams(
            allowed=("echo",),
            rate_bps=self._rate_bps,
            seed=self._random.getrandbits(64),
            now_ns=now_ns,
        )

    def open(self, now_ns: int, service: str = "echo") -> LocalProgram | None:
        token = self.streams.handle_open(service, now_ns)
        if token is None:
            return None
        self.programs[token] = LocalProgram()
        return self.programs[token]

    def work(self, now_ns: int) -> list[bytes]:
        """Let the programs work; return the datagrams for the other end."""
        for token, program in self.programs.items():
            program.work(token, self.streams, now_ns)
        sent = []
        while (octets := self.streams.poll_transmit(now_ns)) is not None:
            sent.append(octets)
        while (event := self.streams.next_event()) is not None:
            if isinstance(event, StreamOpened):
                self.programs[event.token] = LocalProgram()
                continue
            program = self.programs[event.token]
            if isinstance(event, StreamEnded):
                program.ended = True
            elif isinstance(event, StreamClosed):
                program.closed, program.reason = True, event.reason
                del self.programs[event.token]
        return sent


class ServicePair:
    """Ground and space. By seed: datagrams are lost, doubled, overtaken; contact comes and goes."""

    def __init__(
        self,
        seed: int = 0,
        *,
        loss: float = 0.0,
        doubled: float = 0.0,
        overtaken: float = 0.0,
        rate_bps: int = 200_000,
    ) -> None:
        self.now_ns = 0
        self.ground = ServiceEnd(2 * seed, rate_bps=rate_bps)
        self.space = ServiceEnd(2 * seed + 1, rate_bps=rate_bps)
        self.contact = True
        self.sent_octets = {self.ground: 0, self.space: 0}
        self._random = Random(seed)
        self._loss, self._doubled, self._overtaken = loss, doubled, overtaken
        self._flying: list[tuple[int, ServiceEnd, bytes]] = []
        self.step()

    def opened(self) -> tuple[LocalProgram, LocalProgram]:
        """Open a stream from the ground; return its programs at both ends."""
        here = self.ground.open(self.now_ns)
        assert here is not None
        before = set(self.space.programs)
        self.run(1)
        (token,) = set(self.space.programs) - before
        return here, self.space.programs[token]

    def run(self, seconds: float, step_ns: int = 10 * NS_PER_MS) -> None:
        until_ns = self.now_ns + round(seconds * NS_PER_S)
        while self.now_ns < until_ns:
            self.now_ns += step_ns
            self.step()

    def step(self) -> None:
        now_ns, random = self.now_ns, self._random
        for end in (self.ground, self.space):
            end.streams.handle_link(heard=self.contact, waiting_octets=0, now_ns=now_ns)
        if not self.contact:
            self._flying.clear()
        arrived = sorted((one for one in self._flying if one[0] <= now_ns), key=lambda one: one[0])
        self._flying = [one for one in self._flying if one[0] > now_ns]
        for _, end, octets in arrived:
            end.streams.handle_datagram(octets, now_ns)
        for end, other in ((self.ground, self.space), (self.space, self.ground)):
            for octets in end.work(now_ns):
                self.sent_octets[end] += len(octets)
                for _ in range(2 if random.random() < self._doubled else 1):
                    if random.random() < self._loss:
                        continue
                    late = random.random() < self._overtaken
                    late_ns = random.randrange(2 * NS_PER_S) if late else 0
                    self._flying.append((now_ns + 20 * NS_PER_MS + late_ns, other, octets))
