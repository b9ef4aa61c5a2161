"""The processes around the two that are measured: who films, the channel, and who watches.

Each does next to nothing, keeps absolute deadlines, and has a real-time priority where the system
permits one, so that it is the same for everybody that is measured.
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
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from kontur_av.clock import NS_PER_MS, NS_PER_S, NS_PER_US
from kontur_av.sources.pipe import PIPE_OCTETS
from kontur_av.sources.y4m import Y4mPicture, Y4mReader
from pipelines.bench.video.channel import Channel, rtp_payload_octets
from pipelines.bench.video.clips import Clip
from pipelines.bench.video.marks import SQUARES, draw_number, levels

_CHANNEL_PRIORITY, _WATCH_PRIORITY, _FILM_PRIORITY = 12, 11, 11
#: A sleeper wakes up later than told to: what remains of the wait is spent awake.
_AWAKE_NS = 150 * NS_PER_US
_JOIN_S = 5
#: asm-generic/socket.h; Python's `socket` does not name it.
_SO_TIMESTAMPNS = 35
_TIMESPEC = struct.Struct("@qq")
_LOOPBACK = "127.0.0.1"


class EndError(RuntimeError):
    """One of the bench's own processes failed: not a matter of what is measured."""


class End:
    """A child process that runs `work(link)` and gives its result when it is asked to end."""

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
        """What the work gave, after its own end or after `end`."""
        try:
            if not self._link.poll(timeout_s):
                raise EndError(f"{self._name} has not ended after {timeout_s:g} s")
            fault, result = self._link.recv()
        except (EOFError, ConnectionError):
            raise EndError(f"{self._name} has ended without a word") from None
        if fault:
            raise EndError(f"{self._name} failed: {fault}")
        return result

    def end(self) -> None:
        """Ask it to end."""
        with suppress(OSError):
            self._link.send(None)

    def close(self) -> None:
        """It ends now, whatever it does."""
        self._link.close()
        self._process.join(0.1)
        if self._process.is_alive():
            self._process.kill()
            self._process.join(_JOIN_S)


def _become(
    work: Callable[[Connection], Any], link: Connection, others: Connection, priority: int
) -> None:
    others.close()
    # Ctrl-C is the bench's: it ends its children itself.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    for number in (signal.SIGTERM, signal.SIGHUP):
        # What the bench does on it, is not for its children; under nohup they stay deaf.
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
    """captured_ns: for each number the instant of its capture; 0 where the pipe had no room, so
    that the picture was left out, as a camera leaves out what nobody takes. realtime: whether it
    had a real-time priority. latest_ns: the latest start of a picture after its instant."""

    captured_ns: NDArray[np.int64]
    latest_ns: int
    realtime: bool


def film_to(clip: Clip, path: str, fps: int, patience_s: float) -> End:
    """Who films: writes the clip into a FIFO as YUV4MPEG2, each picture at its exact instant.

    A picture is captured at that instant, before its first octet is written. Waits up to
    `patience_s` for a reader, then half a second for that reader to settle. Ends by itself.
    """

    def work(_: Connection) -> Filmed:
        with _opened_for_writing(path, patience_s) as fd:
            return _film(clip, fd, fps)

    return End("the camera", _FILM_PRIORITY, work)


@contextmanager
def _opened_for_writing(path: str, patience_s: float) -> Iterator[int]:
    give_up_ns = time.monotonic_ns() + round(patience_s * NS_PER_S)
    while True:
        try:
            # It opens only where somebody reads (fifo(7)).
            fd = os.open(path, os.O_WRONLY | os.O_NONBLOCK | os.O_CLOEXEC)
            break
        except OSError:
            if time.monotonic_ns() > give_up_ns:
                raise TimeoutError("nobody came to read its pictures") from None
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
            # A pipe smaller than a picture holds its writer up until the reader has caught up.
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
    """shown_ns: when each picture came, in order: when its last octet was in the memory of this
    process. squares: what was seen of its number, as `video_marks.levels`; all of one level for a
    picture that has not the full size. unkept: pictures for which there was no more room."""

    shown_ns: list[int]
    squares: list[NDArray[np.uint8]]
    unkept: int
    garbage_octets: int
    realtime: bool


def watch(path: str, lumas: NDArray[np.uint8]) -> End:
    """Who watches: takes YUV4MPEG2 from a FIFO, and notes which picture came when.

    lumas: shape (count, height, width): the luma planes go there, in the order of their coming.
    Runs until `End.end`.
    """
    # Opened here: who writes into a FIFO may look at once whether somebody reads.
    fd = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    with suppress(OSError):
        fcntl.fcntl(fd, fcntl.F_SETPIPE_SZ, PIPE_OCTETS)
    end = End("the screen", _WATCH_PRIORITY, lambda link: _watch(fd, link, lumas))
    os.close(fd)
    return end


def _watch(fd: int, link: Connection, lumas: NDArray[np.uint8]) -> Watched:
    shown_ns: list[int] = []
    squares: list[NDArray[np.uint8]] = []
    unkept = 0
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
                # No writer (yet): such a FIFO is always readable.
                time.sleep(0.001)
            reader.handle_written(octets)
        now_ns = time.monotonic_ns()
        while (event := reader.next_event()) is not None:
            if not isinstance(event, Y4mPicture):
                continue
            if len(shown_ns) == len(lumas):
                unkept += 1
                continue
            if (event.header.width, event.header.height) == (width, height):
                luma = np.frombuffer(event.octets, np.uint8, width * height).reshape(height, width)
                lumas[len(shown_ns)] = luma
                squares.append(levels(luma))
            else:
                squares.append(np.full(SQUARES, 128, np.uint8))
            shown_ns.append(now_ns)
    return Watched(shown_ns, squares, unkept, reader.garbage_octets, _is_realtime())


@dataclass(frozen=True, slots=True)
class Carried:
    """What passed the channel: for each RTP packet when it came, its octets and its payload's.

    control_octets: of RTCP. returned: datagrams that went back from the receiver to the sender.
    late_ns: how much after its instant each datagram left.
    """

    came_ns: list[int]
    octets: list[int]
    payload_octets: list[int]
    control_octets: int
    returned: int
    late_ns: list[int]
    longest_wait_ns: int
    realtime: bool


class _Ports(Protocol):
    """What `carry` needs to know: where the channel begins and where it leads."""

    @property
    def entrance(self) -> int: ...

    @property
    def exit(self) -> int: ...


def carry(ports: _Ports, rate_bps: int) -> End:
    """The channel: RTP and RTCP from port `entrance` and the next one to `exit` and the next one.

    Both share the rate. What the receiver answers goes back to the sender at once: the other
    direction is not the thin one. Runs until `End.end`.
    """
    with ExitStack() as stack:
        entrances = [stack.enter_context(_bound(ports.entrance + index)) for index in (0, 1)]
        return End(
            "the channel",
            _CHANNEL_PRIORITY,
            lambda link: _carry(entrances, ports.exit, Channel(rate_bps), link),
        )


def _bound(port: int) -> socket.socket:
    udp = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    udp.setblocking(False)
    udp.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 20)
    udp.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPNS, 1)
    udp.bind((_LOOPBACK, port))
    return udp


def _carry(
    entrances: list[socket.socket], exit_port: int, channel: Channel, link: Connection
) -> Carried:
    carried = Carried([], [], [], 0, 0, [], 0, _is_realtime())
    control_octets = returned = 0
    sender: Any = None
    out = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    out.setblocking(False)
    out.bind((_LOOPBACK, 0))
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
                answer = out.recv(65_535)
                if sender is not None:
                    entrances[1].sendto(answer, sender)
                    returned += 1
        for came_ns, port, datagram, source in sorted(_arrived(entrances)):
            sender = source
            channel.handle_datagram(datagram, port, came_ns)
            if port:
                control_octets += len(datagram)
                continue
            carried.came_ns.append(came_ns)
            carried.octets.append(len(datagram))
            carried.payload_octets.append(rtp_payload_octets(datagram))
        due_ns = channel.poll_timeout()
        if due_ns is not None and due_ns - time.monotonic_ns() < 2 * _AWAKE_NS:
            _sleep_until(due_ns)
        while (departure := channel.poll_transmit(time.monotonic_ns())) is not None:
            # A receiver that has not begun yet, or has gone, is no matter of the channel.
            with suppress(OSError):
                out.sendto(departure.datagram, (_LOOPBACK, exit_port + departure.port))
            carried.late_ns.append(time.monotonic_ns() - departure.due_ns)
    return Carried(
        carried.came_ns,
        carried.octets,
        carried.payload_octets,
        control_octets,
        returned,
        carried.late_ns,
        channel.longest_wait_ns,
        carried.realtime,
    )


def _arrived(entrances: list[socket.socket]) -> Iterator[tuple[int, int, bytes, Any]]:
    """(when, port, datagram, source) by the kernel's own stamp: however late this process looks."""
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
                # A wall clock that is set meanwhile must not move an arrival by more than this.
                yield now_ns - min(max(age_ns, 0), 100 * NS_PER_MS), port, datagram, source


def _is_realtime() -> bool:
    return os.sched_getscheduler(0) == os.SCHED_FIFO
