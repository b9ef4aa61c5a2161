"""Write and read the session description (SDP, RFC 8866) of one RTP stream.

aiortc.sdp reads the dialect of WebRTC, and refuses SDP of GStreamer and FFmpeg.
"""

import base64
import binascii
import ipaddress
import re
from collections import defaultdict
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Literal

from kontur_av.errors import ConfigError
from kontur_av.media import AUDIO_CLOCK_HZ, VIDEO_CLOCK_HZ, VideoCodec
from kontur_av.media import AUDIO_PAYLOAD_TYPE as AUDIO_PAYLOAD_TYPE
from kontur_av.media import VIDEO_PAYLOAD_TYPE as VIDEO_PAYLOAD_TYPE
from kontur_av.rtp.annex_b import split_annex_b
from kontur_av.rtp.header_extensions import ABS_CAPTURE_TIME, PICTURE
from kontur_av.rtp.nal_formats import H265, H265_PPS, H265_SPS, H265_VPS, NAL_FORMATS

_UDP_OCTETS, _RTP_OCTETS = 8, 12
#: Three octets (RFC 6184 section 8.1).
_LEVEL = re.compile("[0-9A-F]{6}")
#: Plain RTP over UDP, or encrypted. Some cameras write "udp", others more behind it.
_PROFILE = re.compile("((UDP/TLS/)?RTP/.*|udp)", re.IGNORECASE)
#: What may stand before the description: "SDP:" by ffmpeg, or the head of an RTSP server's answer.
_BEGIN = re.compile("^[ \t]*(?=v=)", re.MULTILINE)
#: Where a stream may be sent to that is described without an address.
_ANY_HOST = "0.0.0.0"
_NAL_EXT = 13  # extension of an SPS
#: By the name in a=rtpmap, in small letters.
_ENCODINGS: Mapping[str, VideoCodec] = {"h264": "h264", "h265": "h265", "hevc": "h265"}
#: By the name in a=fmtp (RFC 7798 section 7.1): the type of the NAL units.
_SPROPS = {"sprop-vps": H265_VPS, "sprop-sps": H265_SPS, "sprop-pps": H265_PPS}
#: Of elements with one-octet headers (RFC 8285 section 4.2).
_IDS = frozenset(map(str, range(1, 15)))


@dataclass(frozen=True, slots=True, kw_only=True)
class StreamDescription:
    """One stream of plain RTP over UDP.

    kind: "video" or "audio", which is Opus.
    codec: of "video": H.264 in packetization-mode 1 or 0, or HEVC without decoding order numbers.
    Of mode 2 only the payloads of modes 0 and 1 are taken; some senders name 2 but use no others.
    host: the IP address to which the stream is sent.
    port: of RTP, from 1 to 65534.
    payload_type: of RTP, from 0 to 127.
    rtcp_port: of RTCP; None: port + 1. It may be `port` (RFC 5761).
    bandwidth_bps: the most that the stream takes, in bit/s with headers of IP, UDP and RTP
    (`session_bandwidth_bps`), or None.
    parameter_sets: VPS (HEVC), SPS and PPS NAL units, if known (video).
    profile_level_id: of H.264, three octets as hexadecimal digits (RFC 6184 section 8.1). "": that
    of the first SPS. A stream whose pictures may grow gives that of the largest.
    feedback: the profile is RTP/AVPF (RFC 4585), in which reports may be frequent. The sender of a
    picture takes PLIs.
    reduced_size: the sender takes PLIs without a report before them (RFC 5506).
    capture_time_id: of the header extension ABS_CAPTURE_TIME, 1 to 14; None: the stream has none.
    picture_id: likewise, of the header extension PICTURE.
    sources: the only IP addresses that send to the group `host` (RFC 4570); empty: any.
    name: of the session (s=).
    """

    kind: Literal["video", "audio"]
    host: str
    port: int
    payload_type: int
    rtcp_port: int | None = None
    bandwidth_bps: int | None = None
    codec: VideoCodec = "h264"
    parameter_sets: tuple[bytes, ...] = ()
    profile_level_id: str = ""
    feedback: bool = False
    reduced_size: bool = False
    capture_time_id: int | None = None
    picture_id: int | None = None
    sources: tuple[str, ...] = ()
    name: str = "kontur-av"

    @property
    def clock_rate_hz(self) -> int:
        return VIDEO_CLOCK_HZ if self.kind == "video" else AUDIO_CLOCK_HZ

    @property
    def control_port(self) -> int:
        """The port of RTCP."""
        return self.port + 1 if self.rtcp_port is None else self.rtcp_port


def session_bandwidth_bps(cap_bps: int, packets_per_s: float, host: str = "0.0.0.0") -> int:
    """Return the bandwidth of `b=AS` (RFC 8866 section 5.8, RFC 3550 section 6.2) in bit/s.

    cap_bps: of the payload. host: the address; it says which version of IP.
    """
    ip_octets = 40 if ipaddress.ip_address(host).version == 6 else 20
    return cap_bps + round(packets_per_s * 8 * (ip_octets + _UDP_OCTETS + _RTP_OCTETS))


def write_sdp(stream: StreamDescription) -> str:
    """Return SDP text that GStreamer's sdpdemux, ffmpeg and ffplay open unchanged.

    Feedback is offered with the profile RTP/AVPF only, as RFC 4585 section 4.2 demands.
    """
    host = ipaddress.ip_address(stream.host)
    address = f"IN IP{host.version} {stream.host}"
    # RFC 8866 section 5.7 demands a TTL. The system's own is 1.
    ttl = "/1" if host.version == 4 and host.is_multicast else ""
    payload_type = stream.payload_type
    profile = "RTP/AVPF" if stream.feedback else "RTP/AVP"
    lines = [
        "v=0",
        f"o=- 0 0 {address}",
        f"s={stream.name}",
        f"c={address}{ttl}",
        "t=0 0",
        f"m={stream.kind} {stream.port} {profile} {payload_type}",
    ]
    if stream.bandwidth_bps is not None:
        lines.append(f"b=AS:{-(-stream.bandwidth_bps // 1000)}")
    if stream.control_port == stream.port:
        lines.append("a=rtcp-mux")
    elif stream.control_port != stream.port + 1:
        lines.append(f"a=rtcp:{stream.rtcp_port}")
    if stream.kind == "video":
        h264 = stream.codec == "h264"
        parameters = _h264_parameters(stream) if h264 else _h265_parameters(stream)
        lines.append(f"a=rtpmap:{payload_type} {stream.codec.upper()}/{VIDEO_CLOCK_HZ}")
        if parameters:
            lines.append(f"a=fmtp:{payload_type} {parameters}")
        if stream.feedback:
            lines.append(f"a=rtcp-fb:{payload_type} nack pli")
    else:
        # RFC 7587 section 7: rtpmap is always 48000/2; fmtp says mono.
        lines.append(f"a=rtpmap:{payload_type} opus/{AUDIO_CLOCK_HZ}/2")
        lines.append(f"a=fmtp:{payload_type} stereo=0;sprop-stereo=0;cbr=1")
        lines.append("a=ptime:20")
    if stream.feedback and stream.reduced_size:
        lines.append("a=rtcp-rsize")
    for number, uri in ((stream.capture_time_id, ABS_CAPTURE_TIME), (stream.picture_id, PICTURE)):
        if number is not None:
            lines.append(f"a=extmap:{number} {uri}")
    lines.append("a=recvonly")
    return "\r\n".join(lines) + "\r\n"


def profile_level_id(parameter_sets: tuple[bytes, ...]) -> str:
    """Return `profile-level-id` of the first SPS (RFC 6184 section 8.1); "" without one."""
    sps = next((unit for unit in parameter_sets if len(unit) >= 4 and unit[0] & 31 == 7), b"")
    return sps[1:4].hex().upper()


def _h264_parameters(stream: StreamDescription) -> str:
    parameters = ["packetization-mode=1"]
    parameter_sets = stream.parameter_sets
    if level := stream.profile_level_id or profile_level_id(parameter_sets):
        parameters.append(f"profile-level-id={level}")
    if parameter_sets:
        coded = ",".join(base64.b64encode(unit).decode() for unit in parameter_sets)
        parameters.append(f"sprop-parameter-sets={coded}")
    return ";".join(parameters)


def _h265_parameters(stream: StreamDescription) -> str:
    """RFC 7798 section 7.1."""
    parameters = []
    for name, kind in _SPROPS.items():
        sets = [unit for unit in stream.parameter_sets if H265.nal_type(unit) == kind]
        if sets:
            coded = ",".join(base64.b64encode(unit).decode() for unit in sets)
            parameters.append(f"{name}={coded}")
    return ";".join(parameters)


def parse_sdp(text: str) -> StreamDescription:
    """Return the first H.264, HEVC or Opus stream that the SDP describes.

    Malformed lines that are not needed are ignored, as by FFmpeg. Raises ConfigError if it
    describes no unencrypted stream of RTP that can be received.
    """
    begin = _BEGIN.search(text.removeprefix("\ufeff").replace("\r", "\n"))
    if begin is None:
        raise ConfigError("this is no SDP: no line begins with v=")
    text = text.removeprefix("\ufeff")[begin.end() :]
    session_host: str | None = None
    session_name = "-"
    session_sources: tuple[str, ...] = ()
    encrypted = False
    fault: ConfigError | None = None
    for block in _blocks(text):
        host = next((_address(value) for key, value in block if key == "c"), session_host)
        sources = _sources(block) or session_sources
        if block[0][0] != "m":
            session_host, session_sources = host, sources
            session_name = next((value for key, value in block if key == "s"), session_name)
            continue
        try:
            stream = _parse_media(block, host or _ANY_HOST, session_name)
        except ConfigError as error:
            # Port 0 rejects a medium, and another one may follow.
            fault = fault or error
            continue
        if stream is not None and "SAVP" not in block[0][1].split()[2].upper():
            return replace(stream, sources=sources)
        encrypted |= stream is not None
    if encrypted:
        raise ConfigError(
            "the SDP's stream is encrypted (RTP/SAVP), and kontur-av receive takes no keys: let "
            "the sender send RTP/AVP, or meet it by WebRTC (kontur-av rtc, kontur-av watch)"
        )
    if fault is not None:
        raise fault
    raise ConfigError(
        "the SDP describes no stream that can be received: it needs "
        "m=video with a=rtpmap H264/90000 or H265/90000, or m=audio with a=rtpmap opus/48000/2"
    )


def _blocks(text: str) -> Iterator[list[tuple[str, str]]]:
    """Yield the session's lines, then those of each m= line, as (key, value)."""
    block: list[tuple[str, str]] = []
    # Only these end lines: a name may hold other separators of Unicode.
    for raw in re.split("[\r\n\0]+", text):
        key, equals, value = raw.strip().partition("=")
        if not equals or len(key) != 1:
            continue
        if key == "m" and block:
            yield block
            block = []
        block.append((key, value.strip()))
    yield block


def _address(value: str) -> str:
    """Return the IP address of a c= line; any address for a name, which only a sender needs."""
    network, kind, address = [*value.split(), "", "", ""][:3]
    try:
        # A multicast address may have a TTL: 224.1.1.1/127 (RFC 8866 section 5.7).
        return str(ipaddress.ip_address(address.partition("/")[0]))
    except ValueError:
        return "::" if (network, kind) == ("IN", "IP6") else _ANY_HOST


def _sources(block: list[tuple[str, str]]) -> tuple[str, ...]:
    """Return the senders that a=source-filter includes (RFC 4570 section 3); empty for any."""
    found: list[str] = []
    for key, value in block:
        attribute, _, rest = value.partition(":")
        mode, _, _, _, *senders = [*rest.split(), "", "", "", ""]
        if key == "a" and attribute.strip() == "source-filter" and mode == "incl":
            for sender in senders:
                with suppress(ValueError):
                    found.append(str(ipaddress.ip_address(sender)))
    return tuple(found)


def _parse_media(block: list[tuple[str, str]], host: str, name: str) -> StreamDescription | None:
    fields = block[0][1].split()
    if len(fields) < 4 or not _PROFILE.fullmatch(fields[2]):
        return None
    told: defaultdict[str, list[str]] = defaultdict(list)
    for key, value in block[1:]:
        attribute, _, rest = value.partition(":")
        told[f"{key}={attribute.strip()}"].append(rest.strip())
    # Both have one clock only (RFC 6184, RFC 7587), whatever some write.
    mapped = [" ".join(rest.split()).partition(" ") for rest in told["a=rtpmap"]]
    maps = {one: encoding.partition("/")[0].lower() for one, _, encoding in mapped}
    parameters = {one: values for one, _, values in (r.partition(" ") for r in told["a=fmtp"])}
    rates = [int(rate[0]) for rest in told["b=AS"] if (rate := re.match("[0-9]{1,9}", rest))]
    control = re.match("[0-9]{1,5}", told["a=rtcp"][-1]) if told["a=rtcp"] else None
    rtcp_port = int(control[0]) if control and 1 <= int(control[0]) <= 65535 else None
    # Only ids of one-octet headers are read; the rest of the line may name a direction.
    extensions = [rest.split()[:2] for rest in told["a=extmap"]]
    told_ids = {one[1]: one[0].partition("/")[0] for one in extensions if one[1:]}
    ids = {uri: int(number) for uri, number in told_ids.items() if number in _IDS}
    kind: Literal["video", "audio"]
    codec: VideoCodec = "h264"
    for payload_type in fields[3:]:
        encoding = maps.get(payload_type, "")
        if fields[0] == "video" and encoding in _ENCODINGS:
            kind, codec = "video", _ENCODINGS[encoding]
        elif fields[0] == "audio" and encoding == "opus":
            kind = "audio"
        else:
            continue
        formats = _parse_formats(parameters.get(payload_type, ""))
        names = _SPROPS if codec == "h265" else ("sprop-parameter-sets",)
        sets = _parse_parameter_sets(",".join(formats.get(name, "") for name in names), codec)
        if formats.get("sprop-max-don-diff", "0") != "0":
            raise ConfigError(
                "SDP sprop-max-don-diff: HEVC with decoding order numbers is not received: let the "
                "sender send in decoding order"
            )
        level = formats.get("profile-level-id", "").upper()
        if not _LEVEL.fullmatch(level):
            level = ""
        return StreamDescription(
            kind=kind,
            host=host,
            # Several ports may be written as 5004/2: only the first is for this stream.
            port=(port := _number(fields[1].partition("/")[0], f"m={kind}, port", 1, 65534)),
            payload_type=_number(payload_type, "m=", 0, 127),
            rtcp_port=port if told["a=rtcp-mux"] else rtcp_port,
            bandwidth_bps=1000 * (rates or [0])[-1] or None,
            feedback="AVPF" in fields[2].upper(),
            reduced_size=bool(told["a=rtcp-rsize"]),
            capture_time_id=ids.get(ABS_CAPTURE_TIME),
            picture_id=ids.get(PICTURE),
            codec=codec,
            parameter_sets=sets,
            profile_level_id="" if level == profile_level_id(sets) else level,
            name=name,
        )
    return None


def _number(text: str, where: str, lowest: int, highest: int) -> int:
    value = int(text) if text.isascii() and text.isdigit() and len(text) < 12 else -1
    if not lowest <= value <= highest:
        raise ConfigError(
            f"SDP {where}: {text[:20]!r} must be a whole number from {lowest} to {highest}"
        )
    return value


def _parse_formats(text: str) -> dict[str, str]:
    formats: dict[str, str] = {}
    for part in text.split(";"):
        key, equals, value = part.strip().partition("=")
        if equals:
            formats[key.strip().lower()] = value.strip().strip('"')
    return formats


def _parse_parameter_sets(text: str, codec: VideoCodec) -> tuple[bytes, ...]:
    """Return the parameter sets in base64, divided by commas. Anything else is left out."""
    form, units = NAL_FORMATS[codec], list[bytes]()
    wanted = form.sets | {_NAL_EXT} if codec == "h264" else form.sets
    for part in text.split(","):
        with suppress(binascii.Error, ValueError):
            unit = base64.b64decode(part.strip() + "===")
            # Some cameras send start codes along.
            found = split_annex_b(unit) if unit[:3] in (b"\0\0\0", b"\0\0\1") else [unit]
            units += [
                one for one in found if one and form.is_nal(one) and form.nal_type(one) in wanted
            ]
    return tuple(units)
