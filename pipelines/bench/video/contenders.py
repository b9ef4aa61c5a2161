"""Who sends and receives the pictures of `bench video`: two commands of this project."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

from kontur_av.clock import NS_PER_S
from kontur_av.errors import ConfigError
from kontur_av.media import VideoCodec
from kontur_av.rtp.sdp import parse_sdp, write_sdp
from pipelines.bench.video.quality import OURS

_START_S = 30.0
_STOP_S = 5.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Course:
    """The measuring course, the same for all contenders.

    width, height, fps: of the pictures. cap_kbps: what the encoder may use. channel_kbps: what
    the channel carries. entrance, exit: the UDP ports of RTP at its two ends; RTCP is one higher.
    film, screen: the FIFOs for pictures to the sender and from the receiver. directory: for files.
    """

    width: int
    height: int
    fps: int
    cap_kbps: float
    channel_kbps: float
    entrance: int
    exit: int
    directory: Path
    film: Path = field(init=False)
    screen: Path = field(init=False)

    def __post_init__(self) -> None:
        for name in ("film", "screen"):
            path = self.directory / f"{name}.y4m"
            os.mkfifo(path)
            object.__setattr__(self, name, path)


class ContenderError(RuntimeError):
    """A contender did not run; with the last words of its output."""


class Process:
    """A running command; its CPU time is measured by the kernel."""

    def __init__(self, name: str, command: Sequence[str], log: Path, fds: Sequence[int]) -> None:
        self.name = name
        self._log = log
        with log.open("wb") as output:
            self._process = subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=output,
                pass_fds=fds,
                # A session of its own: the bench takes Ctrl-C and ends its children itself.
                start_new_session=True,
            )
        self._cpu_s: float | None = None

    def check(self) -> None:
        """ContenderError if it has ended."""
        if self._ended(os.WNOHANG):
            raise ContenderError(f"{self.name} has ended: {self.last_words()}")

    def last_words(self) -> str:
        words = self._log.read_text(errors="replace").strip().splitlines()
        return " / ".join(words[-3:])

    def stop(self, wait_s: float) -> float:
        """Wait for its end, then interrupt it, then kill it; CPU seconds of its whole life."""
        for number in (None, signal.SIGINT, signal.SIGKILL):
            if self._cpu_s is None and number is not None:
                with suppress(ProcessLookupError):
                    self._process.send_signal(number)
            give_up_ns = time.monotonic_ns() + round(wait_s * NS_PER_S)
            while not self._ended(os.WNOHANG) and time.monotonic_ns() < give_up_ns:
                time.sleep(0.02)
            wait_s = _STOP_S
        return self._cpu_s or 0.0

    def _ended(self, options: int) -> bool:
        if self._cpu_s is None:
            pid, status, usage = os.wait4(self._process.pid, options)
            if pid:
                # Popen must not wait for it once more.
                self._process.returncode = os.waitstatus_to_exitcode(status)
                self._cpu_s = usage.ru_utime + usage.ru_stime
        return self._cpu_s is not None


def _our_sender(course: Course, codec: VideoCodec) -> Process:
    options: dict[str, object] = {
        "--video": f"pipe:{course.film}",
        "--to": f"127.0.0.1:{course.entrance}",
        "--cap-kbps": f"{course.cap_kbps:g}",
        "--channel-kbps": f"{course.channel_kbps:g}",
        "--size": f"{course.width}x{course.height}",
        "--fps": course.fps,
        "--codec": codec,
        "--sdp": course.directory / "sent.sdp",
        "--report": course.directory / "sent.json",
    }
    return _ours("send", options, course)


def _our_receiver(course: Course, sender: Process) -> Process:
    sent, received = course.directory / "sent.sdp", course.directory / "received.sdp"
    give_up_ns = time.monotonic_ns() + round(_START_S * NS_PER_S)
    while True:
        # The file may still be incomplete: try until it can be parsed.
        with suppress(ConfigError, FileNotFoundError):
            stream = parse_sdp(sent.read_text())
            break
        sender.check()
        if time.monotonic_ns() > give_up_ns:
            raise ContenderError(f"{sender.name} wrote no SDP")
        time.sleep(0.02)
    received.write_text(write_sdp(replace(stream, port=course.exit)))
    options: dict[str, object] = {
        "--sdp": received,
        "--raw": course.screen,
        "--size": f"{course.width}x{course.height}",
        "--report": course.directory / "received.json",
    }
    return _ours("receive", options, course)


def _ours(command: str, options: dict[str, object], course: Course) -> Process:
    words = [str(word) for option in options.items() for word in option]
    return Process(
        f"kontur-av {command}",
        [sys.executable, "-m", "pipelines.cli", command, *words],
        course.directory / f"{command}.log",
        (),
    )


def wait_for_port(port: int, receiver: Process) -> None:
    give_up_ns = time.monotonic_ns() + round(_START_S * NS_PER_S)
    while port not in open_udp_ports():
        receiver.check()
        if time.monotonic_ns() > give_up_ns:
            raise ContenderError(f"{receiver.name} did not open UDP port {port}")
        time.sleep(0.02)


@contextmanager
def _started(codec: VideoCodec, course: Course) -> Iterator[tuple[Process, Process]]:
    sender = _our_sender(course, codec)
    running = [sender]
    try:
        receiver = _our_receiver(course, sender)
        running.append(receiver)
        wait_for_port(course.exit, receiver)
        yield sender, receiver
    finally:
        for process in running:
            process.stop(0)


@dataclass(frozen=True, slots=True, kw_only=True)
class Contender:
    """A way to bring pictures through the channel.

    started: sender and receiver, ready for the first picture and ended at the exit; raises
    ContenderError if they do not come up. missing: why it cannot run on this machine, if it cannot.
    lead_s: at least this much of a clip goes backwards before it. muxed: as of `ends.carry`.
    """

    name: str
    started: Callable[[Course], AbstractContextManager[tuple[Process, Process]]]
    missing: Callable[[], str | None] = lambda: None
    lead_s: int = 0
    muxed: bool = False


KONTUR_AV = Contender(name=OURS, started=partial(_started, "h264"))
KONTUR_AV_H265 = Contender(name=f"{OURS}-h265", started=partial(_started, "h265"))


_TABLES = (Path("/proc/net/udp"), Path("/proc/net/udp6"))


def open_udp_ports() -> set[int]:
    """The port numbers, of IPv4 and of IPv6 (Linux, proc(5))."""
    return {
        int(line.split()[1].rpartition(":")[2], 16)
        for table in _TABLES
        if table.exists()
        for line in table.read_text().splitlines()[1:]
    }
