"""Cameras and senders in a network: RTSP, HTTP, SRT, RTP and MPEG-TS, through FFmpeg."""

import re
import socket
from pathlib import Path
from struct import unpack_from
from typing import Any, NamedTuple
from urllib.parse import urlsplit

import av

from kontur_av.clock import NS_PER_S, NS_PER_US, MonotonicClock
from kontur_av.errors import ConfigError
from kontur_av.redaction import shown_spec
from kontur_av.sources.live import STALL_S, LiveCapture, in_time

#: A peer that has not answered, or shown what it sends, after this time counts as dead.
_OPEN_S = 10.0
#: The name of a host is looked up before, and the system's resolver cannot be interrupted.
_LONGEST_S = _OPEN_S + 5.0
_NO_ANSWER = f"no answer within {_OPEN_S:g} s: check its address, that it is on, and the network"
#: Between two tries: twice as long each time, up to this; more after a refused password, because
#: cameras lock out who tries often.
_FIRST_PAUSE_NS, _LONGEST_PAUSE_NS, _LOCKED_OUT_NS = NS_PER_S // 2, 5 * NS_PER_S, 60 * NS_PER_S
#: Who sends by RTP says what it is, so nothing is probed. RTSP goes over TCP, or over UDP with a
#: server that cannot. Datagrams that are out of order are waited for, for 50 ms.
_RTP = {
    "rtsp_transport": "tcp+udp",
    "rtsp_flags": "prefer_tcp",
    "allowed_media_types": "video",
    "probesize": "32",
    "analyzeduration": "0",
    "max_delay": "50000",
}
_UDP, _SDP = {"rtsp_transport": "udp"}, {"protocol_whitelist": "file,rtp,udp"}
_PROBED = {"probesize": "500000", "analyzeduration": "500000"}
#: By scheme: FFmpeg's demuxer, if it is known before.
_SCHEMES = {
    **dict.fromkeys(("rtsp", "rtsps", "rtspu"), "rtsp"),
    **dict.fromkeys(("http", "https"), None),
    **dict.fromkeys(("srt", "udp"), "mpegts"),
    "rtp": "rtp",
}
#: These wait for a sender, so their host may be left out.
_WAITING = ("srt", "udp", "rtp")
_ENCODE = "percent-encode all but letters and digits"
_STALLED = f"nothing came for {STALL_S:g} s: check that it is on, and the network"
_WHY: dict[type[Exception], str] = {
    socket.gaierror: "there is no such host: check its name, or give its address",
    ConnectionRefusedError: "nothing listens there: start the server, or check the port",
    av.error.HTTPUnauthorizedError: "its user name or password is refused (401): give those of the "
    f"camera; {_ENCODE}",
    av.error.HTTPForbiddenError: "it is not allowed (403): give a user who may see it",
    av.error.HTTPNotFoundError: "there is no such stream (404): check what follows the host",
    av.error.HTTPOtherClientError: "the server refuses that (4XX): the stream may have no "
    "pictures, or too many viewers",
    av.error.HTTPServerError: "the server failed (5XX): look at its own log",
    av.error.ProtocolNotFoundError: "PyAV's FFmpeg has no such protocol: relay it to "
    "udp://127.0.0.1:PORT (docs/rtp-streams.md)",
    TimeoutError: _STALLED,
    av.error.ExitError: _STALLED,
}
#: Until they are dated, and later, pictures may be this much older than their arrival, or newer.
_FIRST_AGE_NS, _LATER_AGE_NS, _AHEAD_NS = NS_PER_S, 30 * NS_PER_S, NS_PER_S // 20


def reason(error: Exception) -> str:
    """Return why a stream cannot be had, with the fix, in one line without its address."""
    found = (words for kind, words in _WHY.items() if isinstance(error, kind))
    # The text of FFmpeg's errors has the address in it, with its password.
    own = str(error) if isinstance(error, ValueError) else type(error).__name__
    return next(found, getattr(error, "strerror", None) or own)


def pause_ns(failures: int, *, refused: bool) -> int:
    """Return how long to wait after so many failures in a row. refused: the password was."""
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
                raise ValueError(_NO_ANSWER) from None
            raise error from None
        streams, fault = container.streams.video, ""
        if not streams:
            fault = "it has no pictures: give the address of a stream that has"
        # PyAV's type does not say that a stream may have no decoder.
        elif getattr(streams[0], "codec_context", None) is None:
            fault = "FFmpeg cannot decode its pictures: choose H.264, H.265 or MJPEG in the camera"
        elif (container.duration or 0) > 0:
            fault = "it is a film, no live stream: download it, and give the file"
        if fault:
            container.close()
            raise ValueError(fault)
        return container

    def opened_in_time(self, shown: str) -> av.container.InputContainer:
        """Connect; ConfigError with the fix."""
        try:
            return in_time(self.opened, _LONGEST_S)
        except Exception as error:
            why = _NO_ANSWER if type(error) is TimeoutError else reason(error)
            raise ConfigError(f"{shown}: {why}") from None


def _parsed(spec: str) -> _Address:
    """Raise ConfigError unless this is a complete address."""
    shown = shown_spec(spec)
    scheme, _, rest = spec.partition(":")
    scheme = scheme.lower()
    if scheme == "rtp" and not rest.startswith("//"):
        if not Path(rest).is_file():
            raise ConfigError(f"{shown}: no such file: give an SDP file, or rtp://:PORT")
        return _Address(rest, "", "sdp", _RTP | _SDP)
    try:
        parts = urlsplit(spec)
        host, port = parts.hostname or "", parts.port
    except ValueError:
        host, port = "", -1
    waits = scheme in _WAITING
    unfit = scheme not in _SCHEMES or port == -1 or re.search(r"[\s\x00-\x1f\x7f]", spec)
    if unfit or not (port if waits else host):
        form = f"{scheme}://HOST:PORT" if waits else "rtsp://HOST:PORT/PATH"
        raise ConfigError(f"{shown}: write {form}, without spaces; in a password, {_ENCODE}")
    demuxer = _SCHEMES[scheme]
    options = _RTP if demuxer in ("rtsp", "rtp") else _PROBED
    if scheme == "rtspu":
        scheme, options = "rtsp", options | _UDP
    return _Address(f"{scheme}:{rest}", host, demuxer, options)


def check_address(spec: str) -> None:
    """Raise ConfigError, with the fix, if there is no stream of pictures at this address.

    The check connects, as `NetworkVideo` does, and disconnects.
    """
    _parsed(spec).opened_in_time(shown_spec(spec)).close()


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


class NetworkVideo(LiveCapture):
    """Pictures from the network (a `VideoSource`): the newest one, dated by its sender if it can.

    A stream that ends, fails or stalls for 5 s is asked for again, with growing pauses.

    spec: rtsp, rtsps, rtspu (RTSP over UDP), http, https, srt, udp or rtp, `://` and an address; or
        `rtp:` and an SDP file.
    wait: connect before this returns.

    Raises ConfigError as `check_address` does; without `wait`, only for a malformed address.
    """

    check_source = staticmethod(check_address)

    def _first(
        self, spec: str, width: int, height: int, fps: float, *, wait: bool
    ) -> av.container.InputContainer | None:
        self._address = _parsed(spec)
        self._dates = SourceDates()
        self._offset_ns: int | None = None
        self._refused = False
        return self._address.opened_in_time(self._place) if wait else None

    def _open(self) -> av.container.InputContainer:
        self._dates, self._offset_ns, self._refused = SourceDates(), None, False
        return self._address.opened()

    def _reason(self, error: Exception) -> str:
        self._refused = isinstance(error, av.error.HTTPUnauthorizedError)
        return reason(error)

    def _pause_ns(self, failures: int) -> int:
        return pause_ns(failures, refused=self._refused)

    def _stated_ns(self, packet: "av.Packet[Any]", frame: av.VideoFrame, now_ns: int) -> int | None:
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
