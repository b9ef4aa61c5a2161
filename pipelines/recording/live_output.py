"""Hands a received stream on to a player or a server, as it came: `receive --to URL`.

A process of its own connects and writes, because FFmpeg may wait for a peer without an end. What
that process does not take in time is dropped and counted, and the stream goes on.
"""

import multiprocessing
import signal
import time
from collections.abc import Callable
from contextlib import suppress
from multiprocessing.connection import Connection
from queue import Full, Queue
from threading import Thread
from typing import NamedTuple
from urllib.parse import urlsplit

import av

from kontur_av.clock import NS_PER_S
from kontur_av.errors import ConfigError
from kontur_av.hosts import resolve
from kontur_av.media import VideoCodec
from kontur_av.redaction import shown_spec
from pipelines.media.rtp_reports import ForwardedReport
from pipelines.recording.matroska import CodedContainer, Remuxer, begins_stream
from pipelines.session.command_process import say
from pipelines.session.session_metrics import gathered

#: Without delays in the muxer: a picture's length is told, so that no player waits for the next.
_MPEGTS = {"flush_packets": "1", "omit_video_pes_length": "0", "pes_payload_size": "0"}
#: By scheme: the container of FFmpeg, and its options.
_SCHEMES = {
    "udp": ("mpegts", _MPEGTS),
    "srt": ("mpegts", _MPEGTS),
    "rtsp": ("rtsp", {"rtsp_transport": "tcp"}),
    "rtsps": ("rtsp", {"rtsp_transport": "tcp"}),
}
#: Whole packets of a transport stream in a datagram (seven of 188 octets).
_DATAGRAM = "pkt_size=1316"
_RETRY_NS = NS_PER_S
#: Access units or packets of sound that wait for the process: two to four seconds.
_DEPTH = 120
_LAST_S = 2.0


class _Piece(NamedTuple):
    """A picture (Annex B, ticks of 90 kHz), or a packet of sound of `samples` (48 kHz)."""

    data: bytes
    ticks: int
    keyframe: bool
    samples: int


class _State(NamedTuple):
    """What the process that writes has done. needs_key: it waits for a picture to begin with."""

    written: int = 0
    connections: int = 0
    faults: int = 0
    last_fault: str = ""
    needs_key: bool = False


class LiveWriter:
    """One stream of pictures or sound to a URL. It never waits, and never raises after the start.

    Raises ConfigError for a URL that cannot work.
    """

    def __init__(self, url: str, codec: VideoCodec = "h264") -> None:
        self._codec = codec
        self._url, self._shown = _checked(url)
        self._state = _State()
        self._offered = 0
        self._skips = self._broken = self._ended = self._crashed = False
        self._queue: Queue[_Piece | None] = Queue(_DEPTH)
        context = multiprocessing.get_context("fork")
        self._ours, theirs = context.Pipe()
        self._process = context.Process(
            target=_write, args=(theirs, self._ours, self._url, codec), daemon=True
        )
        self._process.start()
        theirs.close()
        self._thread = Thread(target=self._hand_over, name="live output", daemon=True)
        self._thread.start()

    @property
    def needs_key(self) -> bool:
        """Whether a picture with which a player can begin is missing."""
        return self._state.needs_key or self._skips

    def add_unit(self, data: bytes, ticks: int, *, keyframe: bool) -> None:
        """Hand on an access unit (Annex B), shown at `ticks` of 90 kHz."""
        self._offered += 1
        if self._skips and not begins_stream(data, self._codec):
            return
        # Pictures behind one that is missing would show damage.
        self._skips = not self._put(_Piece(data, ticks, keyframe, 0))

    def add_opus(self, payload: bytes, ticks: int, samples: int) -> None:
        """Hand on an Opus packet of `samples` samples, played at `ticks` of 48 kHz."""
        self._offered += 1
        self._put(_Piece(payload, ticks, True, samples))

    def close(self) -> None:
        """End the connection. May be called twice."""
        if self._ended:
            return
        self._ended = True
        with suppress(Full):
            self._queue.put(None, timeout=_LAST_S)
            self._thread.join(_LAST_S)
        self._process.join(_LAST_S)
        self._listen()
        self._crashed = bool(self._process.exitcode)
        self._process.kill()
        self._process.join()

    def report(self) -> ForwardedReport:
        written = self._state.written
        left_out = self._offered - written
        return gathered(
            ForwardedReport, self._state, to=self._shown, packets=written, left_out=left_out
        )

    @property
    def fault(self) -> str:
        """Why nothing was handed on; empty if something was."""
        state = self._state
        if self._crashed:
            return f"--to {self._shown}: its process ended early"
        if state.written:
            return ""
        why = state.last_fault or "no picture came with which a player can begin"
        return f"--to {self._shown}: {why}"

    def _put(self, piece: _Piece) -> bool:
        self._listen()
        try:
            self._queue.put_nowait(piece)
        except Full:
            return False
        return True

    def _listen(self) -> None:
        with suppress(EOFError, OSError):
            while self._ours.poll():
                before, self._state = self._state, self._ours.recv()
                self._publish(before, self._state)

    def _publish(self, before: _State, now: _State) -> None:
        if now.connections > before.connections:
            self._broken = False
            say(f"{self._shown}: the stream goes there")
        elif now.faults > before.faults and not self._broken:
            self._broken = True
            say(f"{self._shown}: {now.last_fault}; tried again every second")

    def _hand_over(self) -> None:
        """In a thread, because the process takes nothing while FFmpeg waits."""
        with suppress(OSError):
            while (piece := self._queue.get()) is not None:
                self._ours.send(piece)
            self._ours.send(None)


def _checked(url: str) -> tuple[str, str]:
    """Return the URL for FFmpeg, and that for people, without a password."""
    parts = urlsplit(url)
    try:
        scheme, host, port = parts.scheme, parts.hostname, parts.port
    except ValueError:
        scheme, host, port = "", None, None
    if scheme not in _SCHEMES or not host or (port is None and not scheme.startswith("rtsp")):
        raise ConfigError(
            f"--to {url!r}: write udp://HOST:PORT, srt://HOST:PORT or rtsp://HOST/NAME"
        )
    if scheme == "srt" and not _has_srt():
        raise ConfigError(
            "--to srt://…: the FFmpeg of this PyAV has no SRT; give --to udp://127.0.0.1:PORT and "
            "relay it, as docs/rtp-streams.md shows"
        )
    resolve(host, url, "--to")
    shown = shown_spec(url)
    if scheme == "udp" and "pkt_size=" not in parts.query:
        url += ("&" if parts.query else "?") + _DATAGRAM
    return url, shown


def _has_srt() -> bool:
    try:
        av.open("srt://", format="mpegts").close()
    except av.error.ProtocolNotFoundError:
        return False
    except (av.FFmpegError, OSError):
        return True
    return True


def _write(inbox: Connection, other: Connection, url: str, codec: VideoCodec) -> None:
    """The process: connect, write, and connect anew a second after a fault."""
    other.close()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    with suppress(EOFError, OSError):
        _Writing(url, codec, inbox.send).run(inbox)


class _Writing:
    def __init__(self, url: str, codec: VideoCodec, publish: Callable[[_State], None]) -> None:
        self._url, self._codec = url, codec
        self._publish = publish
        self._state = _State()
        self._remuxer: Remuxer | None = None
        self._retry_ns = 0

    def run(self, inbox: Connection) -> None:
        while (piece := inbox.recv()) is not None:
            state = self._state
            try:
                state = self._written(piece, state)
            except OSError as error:
                fault = error.strerror or str(error)
                state = state._replace(faults=state.faults + 1, last_fault=fault, needs_key=False)
                self._close()
                self._retry_ns = time.monotonic_ns() + _RETRY_NS
            self._state = state
            self._publish(state)
        self._close()

    def _written(self, piece: _Piece, state: _State) -> _State:
        if self._remuxer is None:
            if time.monotonic_ns() < self._retry_ns:
                return state
            if not piece.samples and not begins_stream(piece.data, self._codec):
                return state._replace(needs_key=True)
            # Told if FFmpeg then waits without an end.
            self._publish(state._replace(last_fault="no answer"))
            form, options = _SCHEMES[urlsplit(self._url).scheme]
            self._remuxer = Remuxer(
                CodedContainer(av.open(self._url, "w", format=form, options=options)), self._codec
            )
        remuxer, before = self._remuxer, self._remuxer.written
        if piece.samples:
            remuxer.add_opus(piece.data, piece.ticks, piece.samples)
        else:
            remuxer.add_unit(piece.data, piece.ticks, keyframe=piece.keyframe)
        begun = state.connections + (before == 0 and remuxer.written > 0)
        written = state.written + remuxer.written - before
        return state._replace(written=written, connections=begun, needs_key=False)

    def _close(self) -> None:
        if self._remuxer is not None:
            with suppress(OSError):
                self._remuxer.close()
        self._remuxer = None
