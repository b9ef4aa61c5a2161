"""Two ends of the services with local programs in memory, and a bad link between them."""

from random import Random

from lossy_pair import LossyPair

from kontur_av.clock import NS_PER_S
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


class ServicePair(LossyPair):
    """Ground and space with datagrams between them."""

    overtaken_ns = 2 * NS_PER_S

    def __init__(self, seed: int = 0, *, rate_bps: int = 200_000, **path: float) -> None:
        super().__init__(seed, **path)
        self.ground = ServiceEnd(2 * seed, rate_bps=rate_bps)
        self.space = ServiceEnd(2 * seed + 1, rate_bps=rate_bps)
        self.sent_octets = {self.ground: 0, self.space: 0}
        self.step()

    def opened(self) -> tuple[LocalProgram, LocalProgram]:
        """Open a stream from the ground; return its programs at both ends."""
        here = self.ground.open(self.now_ns)
        assert here is not None
        before = set(self.space.programs)
        self.run(1)
        (token,) = set(self.space.programs) - before
        return here, self.space.programs[token]

    def tell(self, end: ServiceEnd) -> ServiceStreams:
        return end.streams

    def take(self, end: ServiceEnd, octets: bytes) -> None:
        end.streams.handle_datagram(octets, self.now_ns)

    def note(self, end: ServiceEnd, octets: bytes) -> None:
        self.sent_octets[end] += len(octets)
