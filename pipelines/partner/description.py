"""Offers and answers (SDP, RFC 8829): what each end sends and receives, and how. A core.

All media share one transport (BUNDLE, RFC 9143), and RTP shares it with RTCP (RFC 5761). There is
at most one picture and one voice, as WHIP has it (RFC 9725 section 4.4). No data channel is ever
accepted, so that an unknown sender's messages are not even read.
"""

import re
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, replace
from ipaddress import IPv4Address, ip_address
from typing import Any, Literal

from aiortc import (
    RTCDtlsFingerprint,
    RTCDtlsParameters,
    RTCIceCandidate,
    RTCIceParameters,
    RTCRtpCodecParameters,
    RTCRtpHeaderExtensionParameters,
)
from aiortc.rtcrtpparameters import RTCRtcpFeedback
from aiortc.sdp import (
    GroupDescription,
    MediaDescription,
    SessionDescription,
    SsrcDescription,
    candidate_from_sdp,
    candidate_to_sdp,
)

from kontur_av.errors import ProtocolError, refused
from kontur_av.media import AUDIO_CLOCK_HZ, AUDIO_PAYLOAD_TYPE, VIDEO_CLOCK_HZ, VIDEO_PAYLOAD_TYPE
from kontur_av.rtp.header_extensions import ABS_SEND_TIME, MID, PLAYOUT_DELAY

Kind = Literal["video", "audio"]

#: A longer description is refused unread. Browsers' have 5 to 10 kB.
MOST_SDP_OCTETS = 64 << 10
MOST_LINES = 8
MOST_CANDIDATES = 64

#: What we offer; the ids are ours.
_EXTENSIONS: dict[Kind, dict[str, int]] = {
    "audio": {MID: 1, ABS_SEND_TIME: 2},
    "video": {MID: 1, ABS_SEND_TIME: 2, PLAYOUT_DELAY: 3},
}
_FMTP: dict[Kind, str] = {
    "audio": "minptime=10;useinbandfec=1",
    "video": "level-asymmetry-allowed=1;packetization-mode=1;profile-level-id=42e01f",
}
_FEEDBACK = frozenset(("nack", "nack pli", "ccm fir", "goog-remb"))
_CODECS: dict[Kind, tuple[str, int]] = {
    "audio": ("opus", AUDIO_CLOCK_HZ),
    "video": ("h264", VIDEO_CLOCK_HZ),
}
#: Profiles of H.264 by preference: constrained baseline, baseline, main, high.
_PROFILES = ("42e0", "4200", "4d00", "6400")
_DISCARD_PORT = 9
_ANY_HOST = "0.0.0.0"
_MDNS = re.compile(r"[0-9a-f-]{36}\.local")
#: Of an address without a foundation, as cameras write it: one is as good as another.
_UNFOUNDED = re.compile("^a=candidate: +(?=[0-9]+ )", re.MULTILINE)
#: Attributes that may be left out, and how the parser wants them.
_OPTIONAL = {
    "extmap": re.compile("[0-9]+(/[a-z]+)? [^ ]+"),
    "fmtp": re.compile("[0-9]+ .+"),
    "rtcp-fb": re.compile("([0-9]+|[*]) .+"),
    "ssrc": re.compile("[0-9]+ [^ :]+:.*"),
    "ssrc-group": re.compile("[^ ]+( [0-9]+)+"),
}
_MAPPED = re.compile("^a=rtpmap:([0-9]+) ", re.MULTILINE)
_BROADCAST = IPv4Address("255.255.255.255")
#: What the parser raises for garbage.
MALFORMED = (
    ValueError,
    AssertionError,
    ArithmeticError,
    LookupError,
    AttributeError,
    TypeError,
    StopIteration,
)


class NotAcceptableError(ProtocolError):
    """A description of media that are not taken here, such as VP8."""


@dataclass(frozen=True, kw_only=True)
class Transport:
    """One end's part of the transport.

    ufrag, password: of ICE. candidates: addresses under which it may be reached.
    complete: no more candidates come. fingerprints: pairs of hash and digest of its certificate.
    role: "client", "server" or "auto" in the DTLS handshake. lite: ICE lite (RFC 8445).
    """

    ufrag: str
    password: str
    candidates: tuple[RTCIceCandidate, ...] = ()
    complete: bool = True
    fingerprints: tuple[tuple[str, str], ...] = ()
    role: str = "auto"
    lite: bool = False


def text_of(body: bytes, charset: str | None) -> str:
    """Return a body of HTTP as text. Its charset may be wrong or unknown; SDP is UTF-8."""
    try:
        return body.decode(charset or "utf-8")
    except (LookupError, ValueError):
        return body.decode("utf-8", "replace")


def clean_candidates(text: str, *, loopback: bool = True) -> str:
    """Return a description or a fragment without the candidates that no datagram may go to.

    These are ports that do not exist, addresses of everybody or nobody, and what is no address;
    without `loopback` also those of loopback, at which a partner elsewhere would have us send to
    our own programs. Names of mDNS stay.
    """
    text = _UNFOUNDED.sub("a=candidate:0 ", text)
    return "".join(
        line for line in text.splitlines(keepends=True) if _may_stay(line.strip(), loopback)
    )


def _readable(text: str) -> str:
    """Return a description without the lines that only the parser refuses, and nobody needs."""
    kept: list[str] = []
    for section in re.split("^(?=m=)", text, flags=re.MULTILINE):
        mapped = set(_MAPPED.findall(section))
        for line in section.splitlines(keepends=True):
            name, _, value = line.strip().partition(":")
            form = _OPTIONAL.get(name.removeprefix("a="))
            if form is None or (
                form.fullmatch(value)
                and (name != "a=fmtp" or not mapped or value.split()[0] in mapped)
            ):
                kept.append(line)
    return "".join(kept)


def _may_stay(line: str, loopback: bool) -> bool:
    if not line.startswith("a=candidate:"):
        return True
    words = line.split()
    try:
        port = int(words[5])
    except (ValueError, IndexError):
        # The parser refuses it.
        return True
    # One of TCP, which nobody uses here, may have 9, the port to discard.
    if not 1 <= port <= 65_535:
        return False
    if _MDNS.fullmatch(words[4].lower()):
        return True
    try:
        address = ip_address(words[4])
    except ValueError:
        return False
    mapped = getattr(address, "ipv4_mapped", None) or address
    wanted = loopback or not mapped.is_loopback
    return wanted and not (mapped.is_multicast or mapped.is_unspecified or mapped == _BROADCAST)


@dataclass(frozen=True, kw_only=True)
class MediaLine:
    """One picture or voice, as both ends have agreed, or as one end offers.

    mid: its name in both descriptions. sends, receives: of this end.
    payload_type: of its RTP packets. extensions: ids of header extensions by URI.
    feedback: what a receiver may send: "nack", "nack pli", "ccm fir", "goog-remb".
    ssrc: of what this end sends. peer_ssrc: of what the peer sends; None if not told.
    fmtp: parameters of the codec, as text.
    """

    mid: str
    kind: Kind
    sends: bool
    receives: bool
    payload_type: int
    extensions: dict[str, int]
    feedback: frozenset[str]
    ssrc: int = 0
    peer_ssrc: int | None = None
    fmtp: str = ""


@dataclass(frozen=True, kw_only=True)
class Offer:
    """A description of the peer, an offer or an answer.

    lines: the media that can be used, perhaps several of a kind. mids: all of its media sections in
    order, with the words after "m=" of those that are not used, which an answer rejects.
    """

    lines: tuple[MediaLine, ...]
    mids: tuple[tuple[str, str, str], ...]
    transport: Transport


def wanted_line(
    kind: Kind, *, mid: str, ssrc: int, sends: bool = False, receives: bool = False
) -> MediaLine:
    return MediaLine(
        mid=mid,
        kind=kind,
        sends=sends,
        receives=receives,
        payload_type=VIDEO_PAYLOAD_TYPE if kind == "video" else AUDIO_PAYLOAD_TYPE,
        extensions=dict(_EXTENSIONS[kind]),
        feedback=_FEEDBACK if kind == "video" else frozenset(),
        ssrc=ssrc,
        fmtp=_FMTP[kind],
    )


def write_description(
    lines: Sequence[MediaLine],
    transport: Transport,
    *,
    session: int,
    cname: str,
    stream: str,
    answers: Offer | None = None,
) -> str:
    """Return an offer of `lines`, or the answer to `answers` with those of its lines.

    session: a number of 63 bits for the origin. cname: of all streams. stream: a name for what is
    sent, so that a receiver keeps sound and picture together (RFC 8830).
    """
    description = SessionDescription()
    description.origin = f"- {session} 2 IN IP4 127.0.0.1"
    description.msid_semantic.append(GroupDescription(semantic="WMS", items=["*"]))
    by_mid = {line.mid: line for line in lines}
    order = [(line.mid, "", "") for line in lines] if answers is None else list(answers.mids)
    for mid, kind, rest in order:
        line = by_mid.get(mid)
        description.media.append(
            _rejected(mid, kind, rest, transport)
            if line is None
            else _section(line, transport, cname=cname, stream=stream)
        )
    group: list[int | str] = [mid for mid, _, _ in order if mid in by_mid]
    description.group.append(GroupDescription(semantic="BUNDLE", items=group))
    text = str(description)
    # RTCP of any size may travel alone (RFC 5506); sets of candidates may grow (RFC 8838).
    return text.replace("a=rtcp-mux\r\n", "a=rtcp-mux\r\na=rtcp-rsize\r\n")


def read_description(text: str, *, answers: bool, ssrcs: dict[Kind, int]) -> Offer:
    """Return what a peer's description says. Raises ProtocolError for what cannot be used.

    answers: it answers an offer of ours. ssrcs: by kind, of what this end would send.
    """
    if len(text) > MOST_SDP_OCTETS:
        raise ProtocolError(f"a description of {len(text)} octets: {MOST_SDP_OCTETS} are most")
    with refused("not a session description", *MALFORMED, raising=ProtocolError):
        parsed = SessionDescription.parse(_readable(clean_candidates(text)))
        return _read(parsed, answers=answers, ssrcs=ssrcs)


def common_line(offered: MediaLine, *, sends: bool, receives: bool) -> MediaLine | None:
    """Return an offered line with what this end wants of it; None if that is nothing."""
    sends, receives = sends and offered.sends, receives and offered.receives
    if not (sends or receives):
        return None
    ours = _EXTENSIONS[offered.kind]
    extensions = {uri: number for uri, number in offered.extensions.items() if uri in ours}
    feedback = offered.feedback & _FEEDBACK
    return replace(
        offered, sends=sends, receives=receives, extensions=extensions, feedback=feedback
    )


def common_lines(
    offered: Iterable[MediaLine], *, sends: Collection[Kind], receives: Collection[Kind]
) -> list[MediaLine]:
    """Return what this end takes of an offer: of each kind the first line with a wanted direction.

    sends, receives: kinds that this end sends, and those that it takes.
    """
    found: dict[Kind, MediaLine] = {}
    for one in offered:
        line = common_line(one, sends=one.kind in sends, receives=one.kind in receives)
        if line is not None:
            found.setdefault(one.kind, line)
    return list(found.values())


def write_candidates(transport: Transport, *, mid: str) -> str:
    """Return candidates as a fragment for trickle ICE (RFC 8840 section 9)."""
    lines = [f"a=ice-ufrag:{transport.ufrag}", f"a=ice-pwd:{transport.password}"]
    lines += [f"m=audio {_DISCARD_PORT} RTP/AVP 0", f"a=mid:{mid}"]
    lines += [f"a=candidate:{candidate_to_sdp(candidate)}" for candidate in transport.candidates]
    lines += ["a=end-of-candidates"] if transport.complete else []
    return "\r\n".join(lines) + "\r\n"


def read_candidates(text: str) -> Transport:
    """Return what a fragment for trickle ICE says. Raises ProtocolError for garbage."""
    if len(text) > MOST_SDP_OCTETS:
        raise ProtocolError(f"a fragment of {len(text)} octets: {MOST_SDP_OCTETS} are most")
    said = [line.strip().partition(":") for line in clean_candidates(text).splitlines()]
    ufrag = next((value for key, _, value in said if key == "a=ice-ufrag" and value), "")
    password = next((value for key, _, value in said if key == "a=ice-pwd" and value), "")
    with refused("not a candidate of ICE", *MALFORMED, raising=ProtocolError):
        candidates = [candidate_from_sdp(value) for key, _, value in said if key == "a=candidate"]
    if not ufrag or not password:
        raise ProtocolError("a fragment without ICE's user name and password")
    return Transport(
        ufrag=ufrag,
        password=password,
        candidates=tuple(candidates[:MOST_CANDIDATES]),
        complete=any(key == "a=end-of-candidates" for key, _, _ in said),
    )


def _read(parsed: SessionDescription, *, answers: bool, ssrcs: dict[Kind, int]) -> Offer:
    if not parsed.media or len(parsed.media) > MOST_LINES:
        raise ProtocolError(f"{len(parsed.media)} media sections: 1 to {MOST_LINES} are taken")
    bundled = {
        str(mid) for group in parsed.group if group.semantic == "BUNDLE" for mid in group.items
    }
    mids = [media.rtp.muxId for media in parsed.media]
    if len(set(mids)) != len(mids):
        raise ProtocolError("media sections without names of their own")
    lines: list[MediaLine] = []
    sections: list[tuple[str, str, str]] = []
    for media in parsed.media:
        mid = media.rtp.muxId
        rest = f"{media.profile} {' '.join(map(str, media.fmt))}"
        sections.append((mid, media.kind, rest))
        line = _read_section(media, ssrcs, answers) if mid in bundled or len(mids) == 1 else None
        if line is not None:
            lines.append(line)
    if not lines:
        raise NotAcceptableError("no bundled H.264 or Opus in the description")
    used = [media for media in parsed.media if media.rtp.muxId in {line.mid for line in lines}]
    # The transport is described in the first section of the bundle, wanted or not (RFC 9143 clause
    # 7.2); others may repeat it. An answer rejects what it does not use.
    main = parsed.media[0] if not answers and parsed.media[0].rtp.muxId in bundled else used[0]
    return Offer(lines=tuple(lines), mids=tuple(sections), transport=_transport(main, answers))


def _transport(media: MediaDescription, answers: bool) -> Transport:
    if media.dtls is None or not media.dtls.fingerprints:
        raise ProtocolError("a description without a certificate's fingerprint")
    if media.ice is None or not media.ice.usernameFragment or not media.ice.password:
        raise ProtocolError("a description without ICE's user name and password")
    role = media.dtls.role
    if answers and role not in ("client", "server"):
        raise ProtocolError("an answer that leaves the role in the DTLS handshake open")
    return Transport(
        ufrag=media.ice.usernameFragment,
        password=media.ice.password,
        candidates=tuple(media.ice_candidates[:MOST_CANDIDATES]),
        complete=media.ice_candidates_complete,
        fingerprints=tuple((one.algorithm, one.value) for one in media.dtls.fingerprints),
        role=role,
        lite=media.ice.iceLite,
    )


def _read_section(
    media: MediaDescription, ssrcs: dict[Kind, int], answers: bool
) -> MediaLine | None:
    """Return the line seen from this end; None for one that cannot be used."""
    if media.kind not in ("audio", "video") or not media.rtcp_mux:
        return None
    kind: Kind = "video" if media.kind == "video" else "audio"
    codec = _codec(media.rtp.codecs, kind, answers)
    direction = media.direction or "sendrecv"
    sends = direction in ("recvonly", "sendrecv")
    receives = direction in ("sendonly", "sendrecv")
    if codec is None or codec.payloadType is None or not (sends or receives):
        return None
    given = codec.parameters.items()
    # An answer repeats this, and a parameter without its value is none.
    fmtp = ";".join(
        name if value is None else f"{name}={value}" for name, value in given if value != ""
    )
    # A port of 0 rejects a section, unless it is bundled with one that has a port.
    return MediaLine(
        mid=media.rtp.muxId,
        kind=kind,
        sends=sends,
        receives=receives,
        payload_type=codec.payloadType,
        extensions={one.uri: one.id for one in media.rtp.headerExtensions if 1 <= one.id <= 14},
        feedback=frozenset(
            f"{one.type} {one.parameter or ''}".rstrip() for one in codec.rtcpFeedback
        ),
        ssrc=ssrcs.get(kind, 0),
        peer_ssrc=media.ssrc[0].ssrc if media.ssrc else None,
        fmtp=fmtp,
    )


def _codec(
    codecs: Iterable[RTCRtpCodecParameters], kind: Kind, answers: bool
) -> RTCRtpCodecParameters | None:
    name, clock_hz = _CODECS[kind]
    usable = [one for one in codecs if (one.name.lower(), one.clockRate) == (name, clock_hz)]
    if kind == "audio":
        return usable[0] if usable else None
    exact = [one for one in usable if str(one.parameters.get("packetization-mode", "0")) == "1"]
    # An answer need not repeat the mode that was offered.
    usable = exact or (usable if answers else [])
    names = [str(one.parameters.get("profile-level-id", "42e01f")).lower()[:4] for one in usable]
    ranks = [_PROFILES.index(name) if name in _PROFILES else len(_PROFILES) for name in names]
    return usable[ranks.index(min(ranks))] if usable else None


def _section(line: MediaLine, transport: Transport, *, cname: str, stream: str) -> MediaDescription:
    media = _bare(line.kind, "UDP/TLS/RTP/SAVPF", [line.payload_type], transport)
    media.port = _DISCARD_PORT
    media.direction = (
        "sendrecv" if line.sends and line.receives else "sendonly" if line.sends else "recvonly"
    )
    media.rtcp_port, media.rtcp_host, media.rtcp_mux = _DISCARD_PORT, _ANY_HOST, True
    media.rtp.muxId = line.mid
    media.rtp.headerExtensions = [
        RTCRtpHeaderExtensionParameters(id=number, uri=uri)
        for uri, number in line.extensions.items()
    ]
    video = line.kind == "video"
    media.rtp.codecs = [
        RTCRtpCodecParameters(
            mimeType="video/H264" if video else "audio/opus",
            clockRate=VIDEO_CLOCK_HZ if video else AUDIO_CLOCK_HZ,
            channels=None if video else 2,
            payloadType=line.payload_type,
            rtcpFeedback=[
                RTCRtcpFeedback(type=kind, parameter=parameter or None)
                for kind, _, parameter in (text.partition(" ") for text in sorted(line.feedback))
            ],
            parameters={line.fmtp: None} if line.fmtp else {},
        )
    ]
    if line.sends:
        media.msid = f"{stream} {line.mid}"
        media.ssrc = [SsrcDescription(ssrc=line.ssrc, cname=cname)]
    return media


def _rejected(mid: str, kind: str, rest: str, transport: Transport) -> MediaDescription:
    """A section that is not wanted: port 0 (RFC 8829 section 5.3.1)."""
    profile, *formats = rest.split(" ")
    media = _bare(kind, profile, formats, transport)
    media.port = 0
    media.direction = None if kind == "application" else "inactive"
    media.rtp.muxId = mid
    return media


def _bare(kind: str, profile: str, formats: list[Any], transport: Transport) -> MediaDescription:
    media = MediaDescription(kind=kind, port=_DISCARD_PORT, profile=profile, fmt=formats)
    media.host = _ANY_HOST
    media.ice = RTCIceParameters(
        usernameFragment=transport.ufrag, password=transport.password, iceLite=transport.lite
    )
    media.ice_options = "trickle"
    media.ice_candidates = list(transport.candidates)
    media.ice_candidates_complete = transport.complete
    media.dtls = RTCDtlsParameters(
        fingerprints=[
            RTCDtlsFingerprint(algorithm=algorithm, value=value)
            for algorithm, value in transport.fingerprints
        ],
        role=transport.role,
    )
    return media
