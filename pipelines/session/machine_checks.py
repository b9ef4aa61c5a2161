"""Checks that this machine has what a session needs; each names the fix.

Each check tries the thing itself: it codes a picture, publishes a sample, or keeps a 1 kHz
schedule. Its verdict is `ok`; `missing` (a session cannot run); or `advice` (it can be better).
"""

import os
import platform
import resource
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from typing import Literal

from kontur_av.clock import NS_PER_MS, NS_PER_S, NS_PER_US, Clock, MonotonicClock
from kontur_av.topics.session_files import SHARED_MEMORY

#: Shared memory that must be free. iceoryx2 reserves far more, but sparsely: measured, a topic of
#: 640x480 pictures uses about 1 MB.
NEEDED_SHM_OCTETS = 48_000_000
#: Files and sockets that a process of a session may have open. The one with the pages has most: a
#: connection each, and a topic each.
NEEDED_DESCRIPTORS = 512


#: The priority of the 1 kHz loops. It is not imported, because that module may be broken.
_RT_PRIORITY = 10
_TIMER_CYCLES = 400
_LIMITS = (
    "put the line '{user} - rtprio {priority}' into /etc/security/limits.d/kontur-av.conf "
    "and log in again"
)


@dataclass(frozen=True, slots=True)
class Finding:
    """The result of a check. fix: what the user can do; empty if nothing is wrong."""

    state: Literal["ok", "missing", "advice"]
    found: str
    fix: str = ""


Check = tuple[str, Callable[[], Finding]]


def checked(check: Callable[[], Finding]) -> Finding:
    # A broken installation may raise any exception, and the doctor must name it.
    try:
        return check()
    except Exception as error:
        text = " ".join(str(error).split()) or "no reason given"
        return Finding("missing", f"{type(error).__name__}: {text}", "install kontur-av anew")


def check_python() -> Finding:
    # pyproject.toml refuses older versions of Python.
    found = f"{platform.python_version()} on {platform.system()} {platform.machine()}"
    if platform.system() != "Linux":
        fix = "use Linux, also in a virtual machine, in WSL 2 or in a container"
        return Finding("missing", found, fix)
    return Finding("ok", found)


def check_h264() -> Finding:
    """Code one grey picture with libx264 and decode it again."""
    import av
    import numpy as np

    from kontur_av.codecs.encoder_settings import H264Settings

    fix = "install PyAV from its wheel (pip install --only-binary av av)"
    for codec, mode in (("libx264", "w"), ("h264", "r")):
        if codec not in av.codecs_available:
            return Finding("missing", f"PyAV {av.__version__} without {codec} ({mode})", fix)
    encoder = av.codec.CodecContext.create("libx264", "w")
    assert isinstance(encoder, av.VideoCodecContext)
    encoder.width, encoder.height, encoder.pix_fmt = 64, 64, "yuv420p"
    encoder.framerate = Fraction(30)
    encoder.options = {"tune": "zerolatency"}
    grey = av.VideoFrame.from_ndarray(np.full((96, 64), 128, np.uint8), format="yuv420p")
    packets = encoder.encode(grey) + encoder.encode(None)
    decoder = av.codec.CodecContext.create("h264", "r")
    assert isinstance(decoder, av.VideoCodecContext)
    pictures = [p for packet in packets for p in decoder.decode(packet)] + decoder.decode(None)
    if len(pictures) != 1:
        return Finding("missing", f"PyAV {av.__version__} codes, but does not decode", fix)
    found = f"PyAV {av.__version__}, libx264 and h264, one picture there and back"
    return Finding("ok", f"{found}; {H264Settings.encoder_in_use()}")


def check_h265() -> Finding:
    import av

    for codec in ("libx265", "hevc"):
        if codec not in av.codecs_available:
            fix = 'leave codec = "h265" out, or install PyAV from its wheel'
            return Finding("advice", f"PyAV {av.__version__} without {codec}", fix)
    return Finding("ok", "libx265 and hevc")


def check_opus() -> Finding:
    from kontur_av.codecs import libopus
    from kontur_av.errors import ConfigError

    try:
        found = libopus.load()
    except ConfigError as error:
        return Finding("missing", "libopus", str(error))
    return Finding("ok", f"{found.version}, from {found.origin}: {found.path}")


def check_opencv() -> Finding:
    import cv2

    return Finding("ok", f"OpenCV {cv2.__version__}")


def check_webrtc() -> Finding:
    import aiortc

    return Finding("ok", f"aiortc {aiortc.__version__}")


def check_shared_memory(
    free_octets: Callable[[], int] = lambda: shutil.disk_usage(SHARED_MEMORY).free,
    needed_octets: int = NEEDED_SHM_OCTETS,
) -> Finding:
    """Check the free shared memory: without room, writers are killed by SIGBUS again and again."""
    if not SHARED_MEMORY.is_dir():
        return Finding("missing", f"no {SHARED_MEMORY}", "mount a tmpfs there")
    free = free_octets()
    found = f"{free / 1e6:.0f} MB free in {SHARED_MEMORY}"
    if not os.access(SHARED_MEMORY, os.W_OK):
        return Finding("missing", f"{SHARED_MEMORY} is not writable", f"chmod 1777 {SHARED_MEMORY}")
    if free < needed_octets:
        needed_mb = -(-needed_octets // 1_000_000)
        return Finding(
            "missing",
            found,
            f"free {needed_mb} MB (in a container: --shm-size={max(256, 2 * needed_mb)}m)",
        )
    return Finding("ok", found)


def check_descriptors() -> Finding:
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    found = f"{soft} open files and sockets a process"
    # A session raises the soft limit by itself.
    if soft < NEEDED_DESCRIPTORS and hard != resource.RLIM_INFINITY and hard < NEEDED_DESCRIPTORS:
        return Finding("missing", found, f"ulimit -n {NEEDED_DESCRIPTORS}")
    return Finding("ok", found)


def take_descriptors() -> None:
    """Raise the soft limit to what a session needs, for this process and its children."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if soft != resource.RLIM_INFINITY and soft < NEEDED_DESCRIPTORS:
        most = NEEDED_DESCRIPTORS if hard == resource.RLIM_INFINITY else hard
        resource.setrlimit(resource.RLIMIT_NOFILE, (min(NEEDED_DESCRIPTORS, most), hard))


def check_topics() -> Finding:
    """Publish samples, read them back, and be woken by each."""
    from importlib.metadata import version

    from kontur_av.media import CaptureStamp
    from kontur_av.topics.bus import TopicBus, topics_are_files
    from kontur_av.topics.session_files import remove_session

    session = f"doctor-{os.getpid()}"
    stamp = CaptureStamp(1, 0, "doctor")
    try:
        with TopicBus(session) as bus:
            writer = bus.writer("ping", max_octets=16)
            reader = bus.reader("ping")
            waiter = bus.waiter([reader])
            writer.publish_octets(b"shared memory ok", stamp)
            came = reader.wait(NS_PER_S)
            lease = reader.latest()
            well = came and lease is not None and lease.payload.tobytes() == b"shared memory ok"
            if lease is not None:
                lease.release()
            waiter.wait(0)
            writer.publish_octets(b"shared memory ok", stamp)
            woken = waiter.wait(NS_PER_S)
    finally:
        remove_session(session)
    by_files = topics_are_files(session)
    found = "files in shared memory" if by_files else f"iceoryx2 {version('iceoryx2')}"
    if not well:
        return Finding(
            "missing", f"{found}: what was published did not arrive", f"check {SHARED_MEMORY}"
        )
    if not woken:
        # See kontur_av/topics/notifier.py.
        kernel = f"Linux {platform.release()}"
        return Finding("missing", f"{kernel} wakes no reader twice", "use Linux 5.14 or newer")
    return Finding("ok", f"{found}, samples published and read, a reader woken by each")


def check_real_time() -> Finding:
    """Try SCHED_FIFO in a child, so that this process stays what it is."""
    if not hasattr(os, "sched_setscheduler"):
        return Finding("advice", "no SCHED_FIFO on this system", "use Linux for a real robot")
    tried = f"import os; os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param({_RT_PRIORITY}))"
    command = [sys.executable, "-I", "-S", "-c", tried]
    attempt = subprocess.run(command, capture_output=True, timeout=10, check=False)
    if attempt.returncode == 0:
        return Finding("ok", f"SCHED_FIFO priority {_RT_PRIORITY} granted")
    limit = resource.getrlimit(resource.RLIMIT_RTPRIO)[1]
    return Finding(
        "advice",
        f"SCHED_FIFO refused (rtprio limit {limit})",
        _LIMITS.format(user=_user(), priority=_RT_PRIORITY),
    )


def check_timer(clock: Clock | None = None) -> Finding:
    """Keep a 1 kHz schedule for a moment, as the haptic loops do."""
    from telepresence.haptics.schedule import PeriodicSchedule

    clock = clock or MonotonicClock()
    schedule = PeriodicSchedule(start_ns=clock.now_ns() + NS_PER_MS)
    lateness_ns: list[int] = []
    while len(lateness_ns) < _TIMER_CYCLES:
        clock.sleep_until_ns(schedule.next_deadline_ns)
        late_ns = schedule.handle_wakeup(clock.now_ns())
        if late_ns >= 0:
            lateness_ns.append(late_ns)
    lateness_ns.sort()
    p50, p99 = (lateness_ns[int(share * (_TIMER_CYCLES - 1))] for share in (0.5, 0.99))
    found = (
        f"1 kHz wake-ups late by {p50 / NS_PER_US:.0f} µs (p50), {p99 / NS_PER_US:.0f} µs (p99), "
        f"{schedule.slips} slips in {_TIMER_CYCLES} cycles"
    )
    if p99 >= NS_PER_MS:
        return Finding("advice", found, "close what else is running, or allow SCHED_FIFO")
    return Finding("ok", found)


def check_processors() -> Finding:
    affinity = getattr(os, "sched_getaffinity", None)
    count = len(affinity(0)) if affinity else (os.cpu_count() or 1)
    if count < 2:
        return Finding("advice", f"{count} processor", "a session is meant for two")
    return Finding("ok", f"{count} processors")


def check_players() -> Finding:
    tools = ("ffmpeg", "ffplay", "gst-launch-1.0")
    there = [tool for tool in tools if shutil.which(tool)]
    lacking = [tool for tool in tools if tool not in there]
    if lacking:
        return Finding(
            "advice",
            f"{', '.join(there) or 'none'} found",
            f"to play a stream elsewhere, install {' and '.join(lacking)} "
            "(Debian: ffmpeg, gstreamer1.0-tools)",
        )
    return Finding("ok", ", ".join(there))


def check_sound_capture() -> Finding:
    found = shutil.which("arecord")
    if found is None:
        return Finding("advice", "no arecord", "for --source NAME=alsa:DEVICE install alsa-utils")
    return Finding("ok", found)


def _user() -> str:
    import getpass

    try:
        return getpass.getuser()
    except (KeyError, OSError):
        return str(os.getuid())


CHECKS: tuple[Check, ...] = (
    ("Python", check_python),
    ("H.264", check_h264),
    ("HEVC", check_h265),
    ("Opus", check_opus),
    ("WebRTC", check_webrtc),
    ("OpenCV", check_opencv),
    ("shared memory", check_shared_memory),
    ("open files", check_descriptors),
    ("topics", check_topics),
    ("processors", check_processors),
    ("timer", check_timer),
    ("real time", check_real_time),
    ("sound capture", check_sound_capture),
    ("other players", check_players),
)
