"""A microphone of this machine: ALSA, through the `arecord` of alsa-utils.

FFmpeg's ALSA reader in PyAV's wheels finds neither the system's configuration nor the plug-ins
(dmix, PipeWire, rate conversion). `arecord` is linked to the system's own library and finds both.
"""

import contextlib
import os
import re
import select
import shutil
import subprocess

import numpy as np

from kontur_av.clock import NS_PER_MS, NS_PER_S, Clock
from kontur_av.errors import ConfigError
from kontur_av.media import AUDIO_CLOCK_HZ, AudioFrame
from kontur_av.sources.source import BLOCK_NS, BLOCK_SAMPLES, RETRY_NS, StampingSource

_BLOCK_OCTETS = 2 * BLOCK_SAMPLES
#: More octets than this in the pipe are old sound, because the reader was away.
_BACKLOG_OCTETS = 5 * _BLOCK_OCTETS
#: Sound may come this much sooner than it should.
_CREDIT_NS = 5 * BLOCK_NS
_OPEN_TIMEOUT_S = 5.0
_OTHER_RATE = re.compile(rb"requested = \d+Hz, got = (\d+)Hz")
#: How much of the messages of `arecord` is kept; only the last line is reported.
_COMPLAINT_OCTETS = 4096


def check_microphone(device: str) -> None:
    """Raise ConfigError, with the fix, if ALSA cannot open `device`.

    The check opens the device briefly and records one sample.
    """
    program = _arecord()
    # With ALSA's conversion of rate, channels and format.
    converted = f"plug{device}" if device.startswith("hw:") else "plughw:0"
    fix = f"choose from `kontur-av devices`, or try alsa:{converted}"
    try:
        done = subprocess.run(
            [*_command(program, device), "-s", "1"],
            env={**os.environ, "LC_ALL": "C"},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            timeout=_OPEN_TIMEOUT_S,
            check=False,
        )
    except subprocess.TimeoutExpired:
        raise ConfigError(
            f"microphone {device!r} gives no sound: end the program that uses it, "
            "or choose from `kontur-av devices`"
        ) from None
    if done.returncode:
        raise ConfigError(f"microphone {device!r} cannot be opened ({_reason(done.stderr)}): {fix}")
    # arecord then records at the other rate all the same.
    if (other := _OTHER_RATE.search(done.stderr)) is not None:
        raise ConfigError(
            f"microphone {device!r} records at {int(other[1])} Hz, not at {AUDIO_CLOCK_HZ}: {fix}"
        )


def _arecord() -> str:
    program = shutil.which("arecord")
    if program is None:
        raise ConfigError("alsa: needs the program `arecord`: apt install alsa-utils")
    return program


def _command(program: str, device: str) -> list[str]:
    return [
        *(program, "-D", device, "-t", "raw", "-f", "S16_LE", "-c", "1"),
        *("-r", str(AUDIO_CLOCK_HZ), "--period-time=10000", "--buffer-time=80000"),
    ]


def _reason(stderr: bytes) -> str:
    told = [line for line in stderr.decode("utf-8", "replace").splitlines() if line.strip()]
    # Behind the reason it lists what would fit.
    lines = [line for line in told if line.startswith(("arecord: ", "ALSA lib"))] or told
    return lines[-1].rsplit(": ", 1)[-1] if lines else "no reason given"


class MicrophoneAudio(StampingSource):
    """The sound of a microphone (an `AudioSource`).

    A block ends when its last sample leaves the pipe. The device's buffer (10 ms a period) is not
    included in the stamp. A device that disappears is opened again, twice a second; meanwhile there
    is no sound.

    Raises ConfigError as `check_microphone` does.
    """

    check_source = staticmethod(check_microphone)

    def __init__(self, name: str, clock: Clock, device: str) -> None:
        check_microphone(device)
        super().__init__(name, clock, device)
        self._rest = b""
        self._complaints = b""
        self._retry_ns = 0
        #: When the present block should be over. Devices such as `null` give sound at any speed.
        self._due_ns = 0
        self._process: subprocess.Popen[bytes] | None = None
        self._start()

    def read(self, timeout_ns: int) -> AudioFrame | None:
        give_up_ns = self._clock.now_ns() + timeout_ns
        while len(self._rest) < _BLOCK_OCTETS:
            now_ns = self._clock.now_ns()
            if self._process is None and now_ns >= self._retry_ns:
                self._start()
            if self._process is None or self._process.stdout is None:
                self._clock.sleep_until_ns(min(give_up_ns, self._retry_ns))
            else:
                self._fetch(self._process.stdout.fileno(), give_up_ns - now_ns)
            if len(self._rest) < _BLOCK_OCTETS and self._clock.now_ns() >= give_up_ns:
                return None
        # Credit for a device whose clock is faster, or which gives several blocks at once.
        soonest_ns = self._due_ns - _CREDIT_NS
        self._clock.sleep_until_ns(min(soonest_ns, give_up_ns))
        if soonest_ns > give_up_ns:
            return None
        self._due_ns = max(self._due_ns, self._clock.now_ns()) + BLOCK_NS * 998 // 1000
        if len(self._rest) > _BACKLOG_OCTETS:
            old = (len(self._rest) - _BLOCK_OCTETS) & ~1
            self._rest = self._rest[old:]
        block, self._rest = self._rest[:_BLOCK_OCTETS], self._rest[_BLOCK_OCTETS:]
        begun_ns = self._clock.now_ns() - BLOCK_NS - len(self._rest) * BLOCK_NS // _BLOCK_OCTETS
        samples = np.frombuffer(block, "<i2").astype(np.int16, copy=False)
        return AudioFrame(samples, self._stamp(begun_ns))

    def close(self) -> None:
        self._stop()

    def _fetch(self, fd: int, wait_ns: int) -> None:
        self._listen_to_complaints()
        poller = select.poll()
        poller.register(fd, select.POLLIN)
        if not poller.poll(max(0, -(-wait_ns // NS_PER_MS))):
            return
        octets = os.read(fd, 1 << 16)
        self._rest += octets
        if not octets:
            self._listen_to_complaints()
            self._fault(_reason(self._complaints))
            self._stop()

    def _listen_to_complaints(self) -> None:
        # arecord writes a line for each overrun. If nobody read them, the full pipe would stop it.
        if self._process is not None and self._process.stderr is not None:
            with contextlib.suppress(OSError):
                said = os.read(self._process.stderr.fileno(), 1 << 16)
                self._complaints = (self._complaints + said)[-_COMPLAINT_OCTETS:]

    def _start(self) -> None:
        self._complaints = b""
        try:
            process = subprocess.Popen(
                [*_command(_arecord(), self._place), "-q"],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                bufsize=0,
            )
            assert process.stderr is not None
            os.set_blocking(process.stderr.fileno(), False)
            self._process = process
        except (OSError, ConfigError) as error:
            self._fault(error)
            self._stop()

    def _stop(self) -> None:
        self._rest = b""
        self._retry_ns = self._clock.now_ns() + RETRY_NS
        process, self._process = self._process, None
        if process is None:
            return
        process.terminate()
        try:
            process.wait(NS_PER_S // 2 / NS_PER_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        for pipe in (process.stdout, process.stderr):
            if pipe is not None:
                pipe.close()
