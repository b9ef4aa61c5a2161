"""A loudspeaker of this machine: sound into `aplay` (ALSA) or `pacat` (PulseAudio, PipeWire).

Both are linked to the system's own libraries, so they find its configuration and its plug-ins.
"""

import fcntl
import os
import shutil
import subprocess
import termios
from pathlib import Path

import numpy as np

from kontur_av.clock import NS_PER_MS, NS_PER_S, Clock
from kontur_av.closing import Closing
from kontur_av.errors import ConfigError
from kontur_av.media import AUDIO_CLOCK_HZ, Pcm
from kontur_av.metrics import metrics_of
from kontur_av.sources.source import RETRY_NS
from kontur_av.streams.voice_receiver import LoudspeakerCounts

#: What a device's buffer holds at most.
BUFFER_NS = 40 * NS_PER_MS
_SAMPLE_OCTETS = 2
#: What may wait in the pipe: a page, the least that the kernel gives. Two blocks fit in.
_PIPE_OCTETS = 4096
_END_S = 1.0


def player_command(spec: str) -> list[str]:
    """Return the command that plays raw sound: int16, mono, 48 kHz, from its standard input.

    spec: `alsa:DEVICE`, `pulse:SINK`, or `default`: PulseAudio's server or PipeWire's if one runs,
    else ALSA. Raises ConfigError for others, and without the program.
    """
    kind, _, device = spec.partition(":")
    if spec == "default":
        server = Path(os.environ.get("XDG_RUNTIME_DIR", "/nowhere"), "pulse", "native")
        kind = "pulse" if server.exists() and shutil.which("pacat") else "alsa"
    elif kind not in ("alsa", "pulse") or not device:
        raise ConfigError(f"loudspeaker {spec!r}: write default, alsa:DEVICE or pulse:SINK")
    name, package = {"alsa": ("aplay", "alsa-utils"), "pulse": ("pacat", "pulseaudio-utils")}[kind]
    program = shutil.which(name)
    if program is None:
        raise ConfigError(f"loudspeaker {spec!r} needs the program {name}: apt install {package}")
    buffer_ms = BUFFER_NS // NS_PER_MS
    if kind == "pulse":
        command = [program, "--playback", "--raw", "--format=s16le", f"--rate={AUDIO_CLOCK_HZ}"]
        command += ["--channels=1", f"--latency-msec={buffer_ms}", "--client-name=kontur-av"]
        return command + [f"--device={device}"] * bool(device)
    command = [program, "-q", "-t", "raw", "-f", "S16_LE", "-c", "1", "-r", str(AUDIO_CLOCK_HZ)]
    command += ["--period-time=10000", f"--buffer-time={1000 * buffer_ms}", "--start-delay=20000"]
    return [*command, "-D", device or "default"]


class Loudspeaker(Closing):
    """Plays blocks of sound. It never waits: a block for which there is no room is dropped.

    A player that ends is started again, twice a second at most. Raises ConfigError as
    `player_command` does.
    """

    def __init__(self, spec: str, clock: Clock) -> None:
        self._command, self._clock = player_command(spec), clock
        self._process: subprocess.Popen[bytes] | None = None
        self._retry_ns = 0
        #: When all sound that the player has read will have been heard.
        self._heard_ns = 0
        self._unread = 0
        self.played = self.play_dropped = self.play_faults = 0
        self.play_fault: str | None = None
        self.play_delay_ms: float | None = None

    @property
    def counts(self) -> LoudspeakerCounts:
        return metrics_of(LoudspeakerCounts, self)

    def play(self, samples: Pcm) -> int | None:
        """Hand a block over; return in how many ns its first sample is heard. None: dropped.

        samples: int16, shape (n,), mono, 48 kHz, n at most 2048. The delay is that of what the
        player has not read, and of its buffer, as computed from the time at which it read.
        """
        now_ns = self._clock.now_ns()
        if self._process is None and now_ns >= self._retry_ns:
            self._start(now_ns)
        pipe = None if self._process is None else self._process.stdin
        if pipe is None:
            self.play_dropped += 1
            return None
        octets = np.ascontiguousarray(samples, "<i2").tobytes()
        try:
            waiting = self._waiting(pipe.fileno())
            self._handle_read(self._unread - waiting, now_ns)
            # A pipe takes up to a page whole, or nothing.
            os.write(pipe.fileno(), octets)
        except BlockingIOError:
            self.play_dropped += 1
            return None
        except OSError:
            self._fail(now_ns)
            self.play_dropped += 1
            return None
        self._unread = waiting + len(octets)
        self.played += 1
        delay_ns = max(self._heard_ns - now_ns, 0) + _duration_ns(waiting)
        self.play_delay_ms = max(round(delay_ns / NS_PER_MS, 1), self.play_delay_ms or 0.0)
        return delay_ns

    def close(self) -> None:
        """End the player, after what it has."""
        process, self._process = self._process, None
        if process is None:
            return
        assert process.stdin is not None and process.stderr is not None
        process.stdin.close()
        try:
            process.wait(_END_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        process.stderr.close()

    def _handle_read(self, octets: int, now_ns: int) -> None:
        """The player has read these octets since the last block."""
        heard_ns = max(self._heard_ns, now_ns - _duration_ns(octets)) + _duration_ns(octets)
        self._heard_ns = min(heard_ns, now_ns + BUFFER_NS)

    def _waiting(self, fd: int) -> int:
        found = fcntl.ioctl(fd, termios.FIONREAD, bytes(4))
        return int.from_bytes(found, "little")

    def _start(self, now_ns: int) -> None:
        self._retry_ns, self._unread, self._heard_ns = now_ns + RETRY_NS, 0, 0
        try:
            process = subprocess.Popen(
                self._command, stdin=subprocess.PIPE, stderr=subprocess.PIPE, bufsize=0
            )
        except OSError as error:
            self.play_faults += 1
            self.play_fault = str(error)
            return
        assert process.stdin is not None and process.stderr is not None
        fcntl.fcntl(process.stdin, fcntl.F_SETPIPE_SZ, _PIPE_OCTETS)
        for pipe in (process.stdin, process.stderr):
            os.set_blocking(pipe.fileno(), False)
        self._process = process

    def _fail(self, now_ns: int) -> None:
        process = self._process
        assert process is not None and process.stderr is not None
        told = (process.stderr.read() or b"").decode("utf-8", "replace").strip().splitlines()
        self.play_faults += 1
        self.play_fault = told[-1] if told else "the player ended without a reason"
        self._retry_ns = now_ns + RETRY_NS
        self.close()


def _duration_ns(octets: int) -> int:
    return octets * NS_PER_S // (_SAMPLE_OCTETS * AUDIO_CLOCK_HZ)
