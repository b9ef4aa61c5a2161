"""The peers of `python -m benchmarks video`: commands of GStreamer, and two pages in Chromium."""

import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path

from benchmarks.video.bridge import BridgeOptions
from benchmarks.video.targets import CHROMIUM, DEFAULT, TUNED
from kontur_av.clock import NS_PER_S
from pipelines.bench.video.contenders import (
    KONTUR_AV,
    KONTUR_AV_H265,
    Contender,
    ContenderError,
    Course,
    Process,
    wait_for_port,
)

_NEEDED = ("x264enc", "avdec_h264", "rtph264pay", "rtph264depay", "y4mdec", "y4menc")
_ENCODERS = {
    DEFAULT: "x264enc tune=zerolatency bitrate={cap_kbps}",
    TUNED: "x264enc tune=zerolatency bitrate={cap_kbps} vbv-buf-capacity=66 intra-refresh=true "
    "key-int-max=600 speed-preset=slower threads=1 psy-tune=psnr",
}
_H264_CAPS = "application/x-rtp,media=video,clock-rate=90000,encoding-name=H264,payload=96"
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
#: Before the clip Chromium gets this much of it backwards, so that its estimate of the rate
#: settles, and what its start has put into the channel's queue is gone. There is no cut between.
CHROMIUM_LEAD_S = 10


def _no_chromium() -> str | None:
    if shutil.which("chromium") is None:
        return "Chromium is not installed (Debian: chromium)"
    return None


def _no_gstreamer() -> str | None:
    if shutil.which("gst-launch-1.0") is None:
        return "GStreamer is not installed (Debian: gstreamer1.0-tools)"
    for element in _NEEDED:
        if subprocess.run(["gst-inspect-1.0", "--exists", element], check=False).returncode:
            return f"GStreamer has no {element} (Debian: its plugins good, bad, ugly and libav)"
    return None


@contextmanager
def _gstreamer(encoder: str, course: Course) -> Iterator[tuple[Process, Process]]:
    receiver = _gst_receiver(course)
    running = [receiver]
    try:
        sender = _gst_sender(encoder, course)
        running.append(sender)
        wait_for_port(course.exit, receiver)
        yield sender, receiver
    finally:
        for process in reversed(running):
            process.stop(0)


def _gst_sender(encoder: str, course: Course) -> Process:
    # Open the FIFO before there is a writer, as `kontur-av send` does.
    fd = os.open(course.film, os.O_RDONLY | os.O_NONBLOCK)
    os.set_blocking(fd, True)
    encoder = encoder.format(cap_kbps=round(course.cap_kbps))
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


#: This project, two encoders of GStreamer, and Chromium with two codecs.
CONTENDERS = {
    one.name: one
    for one in (
        KONTUR_AV,
        KONTUR_AV_H265,
        *(
            Contender(name=name, started=partial(_gstreamer, encoder), missing=_no_gstreamer)
            for name, encoder in _ENCODERS.items()
        ),
        *(
            Contender(
                name=name,
                started=partial(_browsers, codec),
                missing=_no_chromium,
                lead_s=CHROMIUM_LEAD_S,
                muxed=True,
            )
            for name, codec in CHROMIUM.items()
        ),
    )
}
