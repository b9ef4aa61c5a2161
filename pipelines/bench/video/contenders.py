"""The contenders of `bench video`: commands of this project and of GStreamer, and Chromium."""

import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path

from benchmarks.video.bridge import BridgeOptions
from kontur_av.clock import NS_PER_S
from kontur_av.errors import ConfigError
from kontur_av.rtp.sdp import parse_sdp, write_sdp
from pipelines.bench.ports import open_udp_ports
from pipelines.bench.video.targets import CHROMIUM, DEFAULT, OURS, TUNED

_NEEDED = ("x264enc", "avdec_h264", "rtph264pay", "rtph264depay", "y4mdec", "y4menc")
_ENCODERS = {
    DEFAULT: "x264enc tune=zerolatency bitrate={cap_kbps}",
    TUNED: "x264enc tune=zerolatency bitrate={cap_kbps} vbv-buf-capacity=66 intra-refresh=true "
    "key-int-max=600 speed-preset=slower threads=1 psy-tune=psnr",
}
_H264_CAPS = "application/x-rtp,media=video,clock-rate=90000,encoding-name=H264,payload=96"
_START_S = 30.0
_BROWSER_S = 60.0
#: What Chromium's rate leaves of the channel: RTCP and STUN are not in it, and a queue must drain.
#: VP9's pictures are of more different sizes.
_CHROMIUM_SPARE_KBPS = {"H264": 5.0, "VP9": 8.0}
#: Below the first rate Chromium codes half the width and height, as it would choose itself; above
#: it, all. A change of size amid the clip would cost a key picture, and 300 ms.
_HALF_BELOW_KBPS, _HALF = 200.0, 2.0
_CHROMIUM_FLAGS = (
    "--headless=new",
    "--no-sandbox",
    "--no-first-run",
    "--disable-gpu",
    "--disable-extensions",
    "--disable-background-networking",
    # The pages are never in front.
    "--disable-background-timer-throttling",
    "--disable-backgrounding-occluded-windows",
    "--disable-renderer-backgrounding",
    "--disable-features=WebRtcHideLocalIpsWithMdns",
    "--allow-loopback-in-peer-connection",
    # Show each picture once it is decoded, and send each at once: 15 ms and 10 ms sooner.
    "--force-fieldtrials=WebRTC-ForcePlayoutDelay/min_ms:0,max_ms:0/"
    "WebRTC-Video-Pacing/factor:10.0,max_delay:0ms/",
)
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


def missing(name: str) -> str | None:
    """Why this contender cannot run on this machine, if it cannot."""
    if name == OURS:
        return None
    if name in CHROMIUM:
        if shutil.which("chromium") is None:
            return "Chromium is not installed (Debian: chromium)"
        return None
    if shutil.which("gst-launch-1.0") is None:
        return "GStreamer is not installed (Debian: gstreamer1.0-tools)"
    for element in _NEEDED:
        if subprocess.run(["gst-inspect-1.0", "--exists", element], check=False).returncode:
            return f"GStreamer has no {element} (Debian: its plugins good, bad, ugly and libav)"
    return None


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
        """The end of its output."""
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


@contextmanager
def started(name: str, course: Course) -> Iterator[tuple[Process, Process]]:
    """Sender and receiver of the contender, ready for the first picture; ended at the exit.

    Raises ContenderError if they do not come up.
    """
    if name in CHROMIUM:
        with _browsers(CHROMIUM[name], course) as (sender, receiver):
            yield sender, receiver
        return
    running: list[Process] = []
    try:
        if name == OURS:
            running += [_our_sender(course)]
            running += [_our_receiver(course, running[0])]
        else:
            running += [_gst_receiver(course), _gst_sender(name, course)]
            running.reverse()
        sender, receiver = running
        _wait_for_port(course.exit, receiver)
        yield sender, receiver
    finally:
        for process in running:
            process.stop(0)


class _Browser(Process):
    """Chromium with one page; CPU time is that of all its processes."""

    def __init__(self, page: str, url: str, course: Course) -> None:
        profile = course.directory / f"chromium-{page}"
        super().__init__(
            f"Chromium's page {page}",
            ["chromium", *_CHROMIUM_FLAGS, f"--user-data-dir={profile}", url],
            course.directory / f"chromium-{page}.log",
            (),
        )

    def stop(self, wait_s: float) -> float:
        """As `Process.stop`."""
        # Its processes are not waited for by this one, so count before they end.
        used_s = _session_cpu_s(self._process.pid)
        super().stop(wait_s)
        return used_s


def _session_cpu_s(session: int) -> float:
    """CPU seconds of all living processes of a session, and of their children that have ended."""
    ticks = 0
    for path in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError):
            # proc(5): behind the name in parentheses, which may hold anything.
            words = path.read_text().rpartition(")")[2].split()
            if int(words[3]) == session:
                ticks += sum(map(int, words[11:15]))
    return ticks / os.sysconf("SC_CLK_TCK")


@contextmanager
def _browsers(codec: str, course: Course) -> Iterator[tuple[Process, Process]]:
    ready = course.directory / "bridge"
    options = BridgeOptions(
        film=str(course.film),
        screen=str(course.screen),
        entrance=course.entrance,
        exit=course.exit,
        codec=codec,
        cap_kbps=min(course.cap_kbps, course.channel_kbps - _CHROMIUM_SPARE_KBPS[codec]),
        width=course.width,
        height=course.height,
        fps=course.fps,
        shrink=_HALF if course.cap_kbps < _HALF_BELOW_KBPS else 1.0,
        ready=str(ready),
    )
    bridge = Process(
        "the bridge to Chromium",
        [sys.executable, "-m", "benchmarks.video.bridge", options.words()],
        course.directory / "bridge.log",
        (),
    )
    running = [bridge]
    try:
        port = _wait_for_words(ready, bridge, lambda words: words.isdigit())
        receiver = _Browser("receive", f"http://127.0.0.1:{port}/receive", course)
        running.append(receiver)
        sender = _Browser("send", f"http://127.0.0.1:{port}/send", course)
        running.append(sender)
        _wait_for_words(ready, bridge, lambda words: words == "connected")
        yield sender, receiver
    finally:
        for process in reversed(running):
            process.stop(0)


def _wait_for_words(path: Path, process: Process, right: Callable[[str], bool]) -> str:
    give_up_ns = time.monotonic_ns() + round(_BROWSER_S * NS_PER_S)
    while True:
        with suppress(FileNotFoundError):
            if right(words := path.read_text()):
                return words
        process.check()
        if time.monotonic_ns() > give_up_ns:
            raise ContenderError(f"{process.name}: no connection; {process.last_words()}")
        time.sleep(0.02)


def _our_sender(course: Course) -> Process:
    options: dict[str, object] = {
        "--video": f"pipe:{course.film}",
        "--to": f"127.0.0.1:{course.entrance}",
        "--cap-kbps": f"{course.cap_kbps:g}",
        "--channel-kbps": f"{course.channel_kbps:g}",
        "--size": f"{course.width}x{course.height}",
        "--fps": course.fps,
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


def _gst_sender(name: str, course: Course) -> Process:
    # Open the FIFO before there is a writer, as `kontur-av send` does.
    fd = os.open(course.film, os.O_RDONLY | os.O_NONBLOCK)
    os.set_blocking(fd, True)
    encoder = _ENCODERS[name].format(cap_kbps=round(course.cap_kbps))
    try:
        return _gst(
            "sender",
            f"fdsrc fd={fd} blocksize=1048576 ! y4mdec ! {encoder} "
            f"! rtph264pay pt=96 ! udpsink host=127.0.0.1 port={course.entrance} sync=false",
            course,
            fd,
        )
    finally:
        os.close(fd)


def _gst_receiver(course: Course) -> Process:
    fd = os.open(course.screen, os.O_WRONLY)
    try:
        return _gst(
            "receiver",
            # With direct rendering pictures have padding, which y4menc would pass on.
            f"udpsrc port={course.exit} caps={_H264_CAPS} ! rtph264depay "
            f"! avdec_h264 direct-rendering=false ! y4menc ! fdsink fd={fd} sync=false",
            course,
            fd,
        )
    finally:
        os.close(fd)


def _gst(role: str, pipeline: str, course: Course, fd: int) -> Process:
    return Process(
        f"GStreamer's {role}",
        ["gst-launch-1.0", "-q", *pipeline.split()],
        course.directory / f"gst-{role}.log",
        (fd,),
    )


def _wait_for_port(port: int, receiver: Process) -> None:
    give_up_ns = time.monotonic_ns() + round(_START_S * NS_PER_S)
    while port not in open_udp_ports():
        receiver.check()
        if time.monotonic_ns() > give_up_ns:
            raise ContenderError(f"{receiver.name} did not open UDP port {port}")
        time.sleep(0.02)
