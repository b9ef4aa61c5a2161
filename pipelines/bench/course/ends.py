"""The processes around the two that are measured: camera, channel and screen.

Each does little work, keeps absolute deadlines, and has real-time priority where the system permits
it, so that all contenders are measured alike.
"""

import fcntl
import gc
import multiprocessing
import os
import select
import selectors
import signal
import socket
import struct
import termios
import time
import traceback
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from kontur_av.clock import NS_PER_MS, NS_PER_S, NS_PER_US
from kontur_av.sources.pipe import PIPE_OCTETS
from kontur_av.sources.y4m import Y4mPicture, Y4mReader
from pipelines.bench.course.marks import SQUARES, draw_number, levels
from pipelines.bench.video.clips import Clip


class Departure(NamedTuple):
    """A datagram that has passed the channel. due_ns: when its last bit passed."""

    due_ns: int
    port: int
    datagram: bytes


class ThinChannel:
    """Passes datagrams on in order, each after the time that its octets take at `rate_bps`.

    All octets of a datagram count (RTP with its header, RTCP), but not those of UDP and IP.
    The queue is unlimited and drops nothing.
    """

    def __init__(self, rate_bps: int) -> None:
        self._rate_bps = rate_bps
        self._free_ns = 0
        self._queue: deque[Departure] = deque()
        self.longest_wait_ns = 0

    def handle_datagram(self, datagram: bytes, port: int, now_ns: int) -> None:
        """A whole datagram has come at `now_ns` to the port of index `port`."""
        begin_ns = max(self._free_ns, now_ns)
        # Rounded up, so that no datagram leaves before its last bit.
        self._free_ns = begin_ns - (-len(datagram) * 8 * NS_PER_S // self._rate_bps)
        self.longest_wait_ns = max(self.longest_wait_ns, begin_ns - now_ns)
        self._queue.append(Departure(self._free_ns, port, datagram))

    def poll_transmit(self, now_ns: int) -> Departure | None:
        """The next datagram that has passed by now. Call until None."""
        if self._queue and self._queue[0].due_ns <= now_ns:
            return self._queue.popleft()
        return None

    def poll_timeout(self) -> int | None:
        return self._queue[0].due_ns if self._queue else None


def rtp_payload_octets(datagram: bytes) -> int:
    """Octets of an RTP packet without its header (RFC 3550 section 5.1); padding counts."""
    if len(datagram) < 12:
        return 0
    header = 12 + 4 * (datagram[0] & 0x0F)
    if datagram[0] & 0x10 and len(datagram) >= header + 4:
        header += 4 + 4 * int.from_bytes(datagram[header + 2 : header + 4], "big")
    return max(len(datagram) - header, 0)


#: Octets of the authentication tag behind a packet (RFC 3711 section 3.4).
_SRTP_TAG = 10


def muxed_payload_octets(datagram: bytes) -> int | None:
    """Octets of payload of an SRTP packet; None for what else shares the port of a WebRTC peer.

    RFC 7983 tells STUN and DTLS apart by the first octet, RFC 5761 section 4 RTCP by the second.
    """
    if len(datagram) < 12 or datagram[0] >> 6 != 2 or 64 <= datagram[1] & 0x7F < 96:
        return None
    return max(rtp_payload_octets(datagram) - _SRTP_TAG, 0)


_CHANNEL_PRIORITY, _WATCH_PRIORITY, _FILM_PRIORITY = 12, 11, 11
#: The last part of a wait is spent awake, because a sleeper wakes up late.
_AWAKE_NS = 150 * NS_PER_US
_JOIN_S = 5
#: asm-generic/socket.h; Python's `socket` does not name it.
_SO_TIMESTAMPNS = 35
_TIMESPEC = struct.Struct("@qq")
_LOOPBACK = "127.0.0.1"


class EndError(RuntimeError):
    """A process of the bench itself failed, not a contender."""


class End:
    """A child process that runs `work(link)` and returns the result through the pipe."""

    def __init__(self, name: str, priority: int, work: Callable[[Connection], Any]) -> None:
        context = multiprocessing.get_context("fork")
        self._name = name
        self._link, theirs = context.Pipe()
        self._process = context.Process(
            target=_become, args=(work, theirs, self._link, priority), daemon=True
        )
        self._process.start()
        theirs.close()

    def result(self, timeout_s: float) -> Any:
        """The result of the work, after its own end or after `end`; EndError if there is none."""
        try:
            if not self._link.poll(timeout_s):
                raise EndError(f"{self._name} has not ended after {timeout_s:g} s")
            fault, result = self._link.recv()
        except (EOFError, ConnectionError):
            raise EndError(f"{self._name} has ended without a result") from None
        if fault:
            raise EndError(f"{self._name} failed: {fault}")
        return result

    def end(self) -> None:
        with suppress(OSError):
            self._link.send(None)

    def close(self) -> None:
        """End the process now, whatever it does."""
        self._link.close()
        self._process.join(0.1)
        if self._process.is_alive():
            self._process.kill()
            self._process.join(_JOIN_S)


def _become(
    work: Callable[[Connection], Any], link: Connection, others: Connection, priority: int
) -> None:
    others.close()
    # Ctrl-C is for the bench, which ends its children itself.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    for number in (signal.SIGTERM, signal.SIGHUP):
        # The handlers of the bench are not for its children; what nohup ignores stays ignored.
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, signal.SIG_DFL)
    with suppress(OSError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    gc.collect()
    gc.freeze()
    gc.disable()
    try:
        result = ("", work(link))
    except Exception:
        result = (traceback.format_exc(), None)
    with suppress(OSError):
        link.send(result)


@dataclass(frozen=True, slots=True)
class Filmed:
    """What the camera did.

    captured_ns: the instant of capture by number; 0 for a picture that was left out because the
    pipe had no room. latest_ns: the latest start of a picture after its instant. realtime: whether
    the process had real-time priority.
    """

    captured_ns: NDArray[np.int64]
    latest_ns: int
    realtime: bool


def film_to(clip: Clip, path: str, fps: int, timeout_s: float) -> End:
    """The camera: write the clip into a FIFO as YUV4MPEG2, each picture at its exact instant.

    The capture is at that instant, before the first octet is written. The camera waits up to
    `timeout_s` for a reader, then half a second, and ends by itself after the clip.
    """

    def work(_: Connection) -> Filmed:
        with _opened_for_writing(path, timeout_s) as fd:
            return _film(clip, fd, fps)

    return End("the camera", _FILM_PRIORITY, work)


@contextmanager
def _opened_for_writing(path: str, timeout_s: float) -> Iterator[int]:
    give_up_ns = time.monotonic_ns() + round(timeout_s * NS_PER_S)
    while True:
        try:
            # Opening fails until there is a reader (fifo(7)).
            fd = os.open(path, os.O_WRONLY | os.O_NONBLOCK | os.O_CLOEXEC)
            break
        except OSError:
            if time.monotonic_ns() > give_up_ns:
                raise TimeoutError("no reader opened the pipe of the camera") from None
            time.sleep(0.01)
    try:
        os.set_blocking(fd, True)
        with suppress(OSError):
            fcntl.fcntl(fd, fcntl.F_SETPIPE_SZ, PIPE_OCTETS)
        yield fd
    finally:
        os.close(fd)


def _film(clip: Clip, fd: int, fps: int) -> Filmed:
    _, rows, width = clip.pictures.shape
    os.write(fd, b"YUV4MPEG2 W%d H%d F%d:1 Ip A1:1 C420jpeg\n" % (width, rows * 2 // 3, fps))
    head = b"FRAME\n"
    octets = bytearray(head) + bytearray(rows * width)
    picture = np.frombuffer(octets, np.uint8, offset=len(head)).reshape(rows, width)
    capacity = fcntl.fcntl(fd, fcntl.F_GETPIPE_SZ)
    captured_ns = np.zeros(len(clip.order), np.int64)
    latest_ns = 0
    start_ns = time.monotonic_ns() + NS_PER_S // 2
    for number, index in enumerate(clip.order):
        picture[:] = clip.pictures[index]
        draw_number(picture, number)
        due_ns = start_ns + number * NS_PER_S // fps
        if time.monotonic_ns() > due_ns + NS_PER_S // fps:
            # A pipe smaller than a picture blocks its writer until the reader has caught up.
            continue
        _sleep_until(due_ns)
        if capacity >= len(octets) > capacity - _unread(fd):
            continue
        captured_ns[number] = due_ns
        latest_ns = max(latest_ns, time.monotonic_ns() - due_ns)
        rest = memoryview(octets)
        while rest:
            rest = rest[os.write(fd, rest) :]
    return Filmed(captured_ns, latest_ns, _is_realtime())


def _unread(fd: int) -> int:
    count = bytearray(4)
    fcntl.ioctl(fd, termios.FIONREAD, count)
    return int.from_bytes(count, "little")


def _sleep_until(due_ns: int) -> None:
    while (left_ns := due_ns - time.monotonic_ns()) > 0:
        if left_ns > _AWAKE_NS:
            time.sleep((left_ns - _AWAKE_NS) / NS_PER_S)


@dataclass(frozen=True, slots=True)
class Watched:
    """What the screen saw.

    shown_ns: for each picture, in order, the instant at which its last octet was in the memory of
    this process. squares: its number as `marks.levels` reads it; all of one level for a picture of
    another size. Pictures beyond the room for them are not kept.
    """

    shown_ns: list[int]
    squares: list[NDArray[np.uint8]]
    garbage_octets: int
    realtime: bool


def watch(path: str, lumas: NDArray[np.uint8]) -> End:
    """The screen: read YUV4MPEG2 from a FIFO, and note the instant of each picture.

    lumas: shape (count, height, width), uint8; takes the luma planes in order of arrival.
    Runs until `End.end`.
    """
    # Open it here: a writer may check at once whether the FIFO has a reader.
    fd = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    with suppress(OSError):
        fcntl.fcntl(fd, fcntl.F_SETPIPE_SZ, PIPE_OCTETS)
    end = End("the screen", _WATCH_PRIORITY, lambda link: _watch(fd, link, lumas))
    os.close(fd)
    return end


def _watch(fd: int, link: Connection, lumas: NDArray[np.uint8]) -> Watched:
    shown_ns: list[int] = []
    squares: list[NDArray[np.uint8]] = []
    _, height, width = lumas.shape
    reader = Y4mReader()
    poller = select.poll()
    poller.register(link.fileno(), select.POLLIN)
    poller.register(fd, select.POLLIN)
    while not link.poll():
        poller.poll()
        with suppress(BlockingIOError):
            octets = os.readv(fd, [reader.write_view()])
            if not octets:
                # A FIFO without a writer is always readable: do not spin.
                time.sleep(0.001)
            reader.handle_written(octets)
        now_ns = time.monotonic_ns()
        while (event := reader.next_event()) is not None:
            if not isinstance(event, Y4mPicture):
                continue
            if len(shown_ns) == len(lumas):
                continue
            if (event.header.width, event.header.height) == (width, height):
                luma = np.frombuffer(event.octets, np.uint8, width * height).reshape(height, width)
                lumas[len(shown_ns)] = luma
                squares.append(levels(luma))
            else:
                squares.append(np.full(SQUARES, 128, np.uint8))
            shown_ns.append(now_ns)
    return Watched(shown_ns, squares, reader.garbage_octets, _is_realtime())


@dataclass(slots=True)
class Carried:
    """What passed the channel.

    came_ns, octets, payload_octets: of each RTP packet. control_octets: of RTCP. returned:
    datagrams from the receiver back to the sender. late_ns: delay of each datagram after its due
    instant.
    """

    realtime: bool
    came_ns: list[int] = field(default_factory=list)
    octets: list[int] = field(default_factory=list)
    payload_octets: list[int] = field(default_factory=list)
    control_octets: int = 0
    returned: int = 0
    late_ns: list[int] = field(default_factory=list)
    longest_wait_ns: int = 0


def carry(entrance: int, exit_port: int, rate_bps: int, *, muxed: bool = False) -> End:
    """The channel: RTP and RTCP from `entrance` and the next port to `exit_port` and the next one.

    Both share the rate. Answers of the receiver go back to the sender at once, because only the
    forward direction is thin. Runs until `End.end`.

    muxed: for WebRTC. Each side has one port and sends to one port of the channel: the sender to
    `entrance`, the receiver to `exit_port`. The channel learns theirs from what they send.
    """
    with ExitStack() as stack:
        count = 1 if muxed else 2
        entrances = [stack.enter_context(_bound(entrance + index)) for index in range(count)]
        out = stack.enter_context(_bound(exit_port if muxed else 0))
        return End(
            "the channel",
            _CHANNEL_PRIORITY,
            lambda link: _carry(
                entrances, out, None if muxed else exit_port, ThinChannel(rate_bps), link
            ),
        )


def _bound(port: int) -> socket.socket:
    udp = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    udp.setblocking(False)
    udp.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 20)
    udp.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPNS, 1)
    udp.bind((_LOOPBACK, port))
    return udp


def _carry(
    entrances: list[socket.socket],
    out: socket.socket,
    exit_port: int | None,
    channel: ThinChannel,
    link: Connection,
) -> Carried:
    """exit_port: None if the receiver's port is learned, and RTP and RTCP share one."""
    carried = Carried(_is_realtime())
    sender: Any = None
    receiver: Any = None
    selector = selectors.SelectSelector()
    selector.register(link.fileno(), selectors.EVENT_READ)
    for udp in (*entrances, out):
        selector.register(udp, selectors.EVENT_READ)
    while not link.poll():
        due_ns = channel.poll_timeout()
        wait_ns = None if due_ns is None else max(due_ns - time.monotonic_ns() - _AWAKE_NS, 0)
        selector.select(None if wait_ns is None else wait_ns / NS_PER_S)
        with suppress(BlockingIOError, ConnectionError):
            while True:
                answer, receiver = out.recvfrom(65_535)
                if sender is not None:
                    entrances[-1].sendto(answer, sender)
                    carried.returned += 1
        for came_ns, port, datagram, source in sorted(_arrived(entrances)):
            sender = source
            channel.handle_datagram(datagram, port, came_ns)
            if exit_port is None:
                payload_octets = muxed_payload_octets(datagram)
            else:
                payload_octets = None if port else rtp_payload_octets(datagram)
            if payload_octets is None:
                carried.control_octets += len(datagram)
                continue
            carried.came_ns.append(came_ns)
            carried.octets.append(len(datagram))
            carried.payload_octets.append(payload_octets)
        due_ns = channel.poll_timeout()
        if due_ns is not None and due_ns - time.monotonic_ns() < 2 * _AWAKE_NS:
            _sleep_until(due_ns)
        while (departure := channel.poll_transmit(time.monotonic_ns())) is not None:
            if exit_port is not None:
                receiver = _LOOPBACK, exit_port + departure.port
            # The channel does not care whether a receiver is there.
            with suppress(OSError):
                if receiver is not None:
                    out.sendto(departure.datagram, receiver)
            carried.late_ns.append(time.monotonic_ns() - departure.due_ns)
    carried.longest_wait_ns = channel.longest_wait_ns
    return carried


def _arrived(entrances: list[socket.socket]) -> Iterator[tuple[int, int, bytes, Any]]:
    """(instant, port, datagram, source); the instant is the kernel's, however late this reads."""
    for port, udp in enumerate(entrances):
        with suppress(BlockingIOError):
            while True:
                datagram, ancillary, _, source = udp.recvmsg(65_535, 64)
                now_ns, wall_ns = time.monotonic_ns(), time.time_ns()
                age_ns = 0
                for level, kind, data in ancillary:
                    if level == socket.SOL_SOCKET and kind == _SO_TIMESTAMPNS:
                        seconds, rest_ns = _TIMESPEC.unpack(data)
                        age_ns = wall_ns - seconds * NS_PER_S - rest_ns
                # Limit the effect of a wall clock that is set meanwhile.
                yield now_ns - min(max(age_ns, 0), 100 * NS_PER_MS), port, datagram, source


def _is_realtime() -> bool:
    return os.sched_getscheduler(0) == os.SCHED_FIFO
