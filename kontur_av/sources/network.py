"""Cameras and senders in a network: RTSP, HTTP, SRT, RTP and MPEG-TS, through FFmpeg."""

import re
import socket
import threading
from pathlib import Path
from struct import unpack_from
from typing import NamedTuple
from urllib.parse import urlsplit

import av

from kontur_av.clock import NS_PER_S, NS_PER_US, Clock, MonotonicClock
from kontur_av.errors import ConfigError
from kontur_av.redaction import shown_spec
from kontur_av.sources.live import STALL_S, LiveVideo

#: A peer that has not answered, or shown what it sends, after this time counts as dead.
_OPEN_S = 10.0
#: The name of a host is looked up before, and the system's resolver cannot be interrupted.
_LONGEST_S = _OPEN_S + 5.0
#: Between two tries: twice as long each time, up to this; more after a refused password, because
#: cameras lock out who tries often.
_FIRST_PAUSE_NS, _LONGEST_PAUSE_NS, _LOCKED_OUT_NS = NS_PER_S // 2, 5 * NS_PER_S, 60 * NS_PER_S
#: RTSP over TCP, or UDP from a server that cannot. It says what it sends, so nothing is probed.
#: Datagrams that are out of order are waited for, for 50 ms. Sound is not asked for.
_RTSP = {
    "rtsp_transport": "tcp+udp",
    "rtsp_flags": "prefer_tcp",
    "allowed_media_types": "video",
    "probesize": "32",
    "analyzeduration": "0",
    "max_delay": "50000",
    "reorder_queue_size": "64",
}
_RTP = {"max_delay": "50000", "probesize": "32", "analyzeduration": "0"}
_SDP = {"protocol_whitelist": "file,rtp,udp", **_RTP}
_PROBED = {"probesize": "500000", "analyzeduration": "500000"}
#: By scheme: that of FFmpeg, its demuxer, its options.
_SCHEMES: dict[str, tuple[str, str | None, dict[str, str]]] = {
    "rtsp": ("rtsp", "rtsp", _RTSP),
    "rtsps": ("rtsps", "rtsp", _RTSP),
    "rtspu": ("rtsp", "rtsp", {**_RTSP, "rtsp_transport": "udp"}),
    "http": ("http", None, _PROBED),
    "https": ("https", None, _PROBED),
    "srt": ("srt", "mpegts", _PROBED),
    "udp": ("udp", "mpegts", _PROBED),
    "rtp": ("rtp", "rtp", _RTP),
}
#: These wait for a sender, so their host may be left out.
_WAITING = ("srt", "udp", "rtp")
_UNAUTHORIZED = (
    "its user name or password is refused (401): give those of the camera before the host; "
    "percent-encode what is no letter or digit"
)
_WHY: tuple[tuple[type[Exception], str], ...] = (
    (socket.gaierror, "there is no such host: check its name, or give its address"),
    (ConnectionRefusedError, "nothing listens there: start the server, or check the port"),
    (av.error.HTTPUnauthorizedError, _UNAUTHORIZED),
    (av.error.HTTPForbiddenError, "it is not allowed (403): give a user who may see it"),
    (av.error.HTTPNotFoundError, "there is no such stream (404): check what follows the host"),
    (
        av.error.HTTPOtherClientError,
        "the server refuses that (4XX): the stream may have no pictures, or too many viewers",
    ),
    (av.error.HTTPServerError, "the server failed (5XX): look at its own log"),
    (
        av.error.ProtocolNotFoundError,
        "the FFmpeg of this PyAV cannot do that; relay it to udp://127.0.0.1:PORT, "
        "as docs/players.md shows",
    ),
    (TimeoutError, f"nothing came for {STALL_S:g} s: check that it is on, and the network"),
    (av.error.ExitError, f"nothing came for {STALL_S:g} s: check that it is on, and the network"),
)
#: Until they are dated, and later, pictures may be this much older than their arrival, or newer.
_FIRST_AGE_NS, _LATER_AGE_NS, _AHEAD_NS = NS_PER_S, 30 * NS_PER_S, NS_PER_S // 20


def reason(error: Exception) -> str:
    """Return why a stream cannot be had, with the fix, in one line without its address."""
    found = (words for kind, words in _WHY if isinstance(error, kind))
    # The text of FFmpeg's errors has the address in it, with its password.
    own = str(error) if isinstance(error, ValueError) else type(error).__name__
    return next(found, getattr(error, "strerror", None) or own)


def pause_ns(failures: int, *, refused: bool) -> int:
    """Return how long to wait before the next try. refused: by password, the last time.

    failures: in a row.
    """
    longer_ns = min(_FIRST_PAUSE_NS << min(failures, 8), _LONGEST_PAUSE_NS)
    return _LOCKED_OUT_NS if refused else longer_ns


class _Address(NamedTuple):
    """An address as FFmpeg takes it. host: to be looked up before; "" for none."""

    url: str
    host: str
    demuxer: str | None
    options: dict[str, str]

    def opened(self) -> av.container.InputContainer:
        """Connect; raise what `reason` explains."""
        if self.host:
            socket.getaddrinfo(self.host, None)
        begin_ns = MonotonicClock.now_ns()
        try:
            container = av.open(
                self.url,
                format=self.demuxer,
                options=self.options,
                timeout=(_OPEN_S, STALL_S),
                metadata_errors="replace",
            )
        except av.FFmpegError as error:
            if MonotonicClock.now_ns() - begin_ns > (_OPEN_S - 0.5) * NS_PER_S:
                raise ValueError(_no_answer()) from None
            raise error from None
        fault = _unfit(container)
        if fault:
            container.close()
            raise ValueError(fault)
        return container


def _no_answer() -> str:
    return f"no answer within {_OPEN_S:g} s: check its address, that it is on, and the network"


def _unfit(container: av.container.InputContainer) -> str:
    """Why its pictures cannot be taken; "" if they can."""
    streams = container.streams.video
    if not streams:
        return "it has no pictures: give the address of a stream that has"
    # PyAV's type does not say that a stream may have no decoder.
    if getattr(streams[0], "codec_context", None) is None:
        return "FFmpeg cannot decode its pictures: choose H.264, H.265 or MJPEG in the camera"
    if container.duration and container.duration > 0:
        return "it is a film, no live stream: download it, and give the file"
    return ""


def _parsed(spec: str) -> _Address:
    """Raises ConfigError for what is no address."""
    shown = shown_spec(spec)
    scheme, _, rest = spec.partition(":")
    scheme = scheme.lower()
    if scheme == "rtp" and not rest.startswith("/" * 2):
        if not Path(rest).is_file():
            raise ConfigError(f"{shown}: no such file: give an SDP file, or rtp://:PORT")
        return _Address(rest, "", "sdp", _SDP)
    known, demuxer, options = _SCHEMES.get(scheme, ("", None, {}))
    try:
        parts = urlsplit(spec)
        host, port = parts.hostname or "", parts.port
    except ValueError:
        host, port = "", -1
    unfit = not known or port == -1 or re.search(r"[\s\x00-\x1f\x7f]", spec)
    if unfit or not (host or scheme in _WAITING):
        raise ConfigError(
            f"{shown}: write {scheme if known else 'rtsp'}://HOST:PORT/PATH, without spaces; "
            "percent-encode what is no letter or digit in a user name or password"
        )
    if scheme in _WAITING and port is None:
        raise ConfigError(f"{shown}: the port is missing: write {scheme}://HOST:PORT")
    return _Address(known + ":" + rest, host, demuxer, options)


def _opened_in_time(address: _Address, shown: str) -> av.container.InputContainer:
    """Connect; ConfigError with the fix. It never waits for ever, as FFmpeg may."""
    outcome: list[av.container.InputContainer | Exception] = []

    def attempt() -> None:
        try:
            outcome.append(address.opened())
        except Exception as error:
            outcome.append(error)

    thread = threading.Thread(target=attempt, name="connection", daemon=True)
    thread.start()
    thread.join(_LONGEST_S)
    result = outcome[0] if outcome else TimeoutError(_no_answer())
    if isinstance(result, Exception):
        raise ConfigError(f"{shown}: {reason(result)}") from None
    return result


def check_address(spec: str) -> None:
    """Raise ConfigError, with the fix, if there is no stream of pictures at this address.

    The check connects, as `NetworkVideo` does, and disconnects.
    """
    _opened_in_time(_parsed(spec), shown_spec(spec)).close()


class SourceDates:
    """Judges the dates that a connection gives its pictures. A core.

    Many cameras do not set their clocks. The first date that is given decides whether they count.
    """

    def __init__(self) -> None:
        self._true: bool | None = None

    def handle_date(self, stated_ns: int, now_ns: int) -> int | None:
        """Return the instant of a capture that arrived at `now_ns`; None if the date is wrong."""
        age_ns = now_ns - stated_ns
        most_ns = _LATER_AGE_NS if self._true else _FIRST_AGE_NS
        self._true = self._true is not False and -_AHEAD_NS <= age_ns < most_ns
        return min(stated_ns, now_ns) if self._true else None


class NetworkVideo(LiveVideo):
    """Pictures from the network (a `VideoSource`): the newest one, dated by its sender if it can.

    A stream that ends, fails or stalls for 5 s is asked for again, with growing pauses.

    spec: rtsp, rtsps, rtspu (RTSP over UDP), http, https, srt, udp or rtp, `://` and an address; or
        `rtp:` and an SDP file.
    wait: connect before this returns.

    Raises ConfigError as `check_address` does; without `wait`, only for what is no address.
    """

    check_source = staticmethod(check_address)

    def __init__(
        self,
        name: str,
        width: int,
        height: int,
        fps: int,
        clock: Clock,
        spec: str,
        *,
        wait: bool = True,
    ) -> None:
        self._address = _parsed(spec)
        super().__init__(name, width, height, clock, shown_spec(spec))
        self._dates = SourceDates()
        self._offset_ns: int | None = None
        self._refused = False
        self._begin(_opened_in_time(self._address, self._place) if wait else None)

    def _open(self) -> av.container.InputContainer:
        self._dates, self._offset_ns, self._refused = SourceDates(), None, False
        return self._address.opened()

    def _reason(self, error: Exception) -> str:
        self._refused = isinstance(error, av.error.HTTPUnauthorizedError)
        return reason(error)

    def _pause_ns(self, failures: int) -> int:
        return pause_ns(failures, refused=self._refused)

    def _stated_ns(
        self, packet: "av.Packet[av.VideoStream]", frame: av.VideoFrame, now_ns: int
    ) -> int | None:
        """By RTCP's sender reports (RFC 3550 section 6.4.1), which FFmpeg hands over as PRFT."""
        wall_offset_ns: int | None = getattr(self._clock, "wall_offset_ns", None)
        if wall_offset_ns is None or packet.pts is None or packet.time_base is None:
            return None
        tick_s = packet.time_base
        known, fresh = self._offset_ns, None
        if packet.has_sidedata("prft"):
            # AVProducerReferenceTime: the wall clock in µs, for this packet.
            (wall_us,) = unpack_from("=q", bytes(packet.get_sidedata("prft")))
            fresh = wall_us * NS_PER_US - int(packet.pts * tick_s * NS_PER_S)
        self._offset_ns = fresh
        # The first date after a report may be that of the next picture.
        if known is None or fresh is None or frame.pts is None:
            return None
        captured_ns = fresh + int(frame.pts * tick_s * NS_PER_S) - wall_offset_ns
        return self._dates.handle_date(captured_ns, now_ns)
