"""What is written into a session description, and what is read from those of other programs."""

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from kontur_av.errors import ConfigError
from kontur_av.rtp.sdp import StreamDescription, parse_sdp, session_bandwidth_bps, write_sdp

SPS, PPS = b"\x67\x42\xc0\x1e", b"\x68\xce\x3c\x80"
HEAD = "v=0\ns=Room\nc=IN IP4 10.0.0.1\nt=0 0\n"
VIDEO = "m=video 5004 RTP/AVP 96\na=rtpmap:96 H264/90000\n"
#: In base64.
SETS = "Z0LAHg==,aM48gA=="
CAPTURE_TIME = "http://www.webrtc.org/experiments/rtp-hdrext/abs-capture-time"


def stream(**changes) -> StreamDescription:
    values = {"kind": "video", "host": "10.0.0.1", "port": 5004, "payload_type": 96} | changes
    return StreamDescription(**values)


def read(text="", *, head=HEAD, media=VIDEO) -> StreamDescription:
    return parse_sdp(head + media + text)


#: By kind: a stream, and all lines of its description.
WRITTEN = {
    "voice": (
        stream(kind="audio", host="::1", payload_type=97, rtcp_port=6001, bandwidth_bps=8_001),
        """v=0
        o=- 0 0 IN IP6 ::1
        s=kontur-av
        c=IN IP6 ::1
        t=0 0
        m=audio 5004 RTP/AVP 97
        b=AS:9
        a=rtcp:6001
        a=rtpmap:97 opus/48000/2
        a=fmtp:97 stereo=0;sprop-stereo=0;cbr=1
        a=ptime:20
        a=recvonly""",
    ),
    "video": (
        stream(
            bandwidth_bps=85_000,
            parameter_sets=(SPS, PPS),
            profile_level_id="42C015",
            feedback=True,
            reduced_size=True,
            capture_time_id=1,
            picture_id=2,
        ),
        f"""v=0
        o=- 0 0 IN IP4 10.0.0.1
        s=kontur-av
        c=IN IP4 10.0.0.1
        t=0 0
        m=video 5004 RTP/AVPF 96
        b=AS:85
        a=rtpmap:96 H264/90000
        a=fmtp:96 packetization-mode=1;profile-level-id=42C015;sprop-parameter-sets={SETS}
        a=rtcp-fb:96 nack pli
        a=rtcp-rsize
        a=extmap:1 {CAPTURE_TIME}
        a=extmap:2 urn:x-kontur-av:picture
        a=recvonly""",
    ),
    "HEVC": (
        stream(codec="h265", parameter_sets=(b"\x40\1\x0c", b"\x42\1\1", b"\x44\1\xc1")),
        """v=0
        o=- 0 0 IN IP4 10.0.0.1
        s=kontur-av
        c=IN IP4 10.0.0.1
        t=0 0
        m=video 5004 RTP/AVP 96
        a=rtpmap:96 H265/90000
        a=fmtp:96 sprop-vps=QAEM;sprop-sps=QgEB;sprop-pps=RAHB
        a=recvonly""",
    ),
}


@pytest.mark.parametrize("kind", WRITTEN)
def test_a_stream_is_described_in_these_lines_and_read_back(kind):
    described, lines = WRITTEN[kind]
    assert write_sdp(described).splitlines() == [line.strip() for line in lines.splitlines()]
    # The cap is rounded up to whole kbit/s.
    cap_bps = described.bandwidth_bps and -(-described.bandwidth_bps // 1000) * 1000
    assert parse_sdp(write_sdp(described)) == replace(described, bandwidth_bps=cap_bps)


def test_clocks_and_control_ports_are_the_usual_ones_unless_told():
    voice, usual = WRITTEN["voice"][0], stream(rtcp_port=5005)
    assert (voice.clock_rate_hz, voice.control_port) == (48_000, 6001)
    assert (stream().clock_rate_hz, stream().control_port) == (90_000, 5005)
    assert "a=rtcp:" not in write_sdp(usual)
    # Reports may come to the port of the media.
    muxed = read("a=rtcp:9 IN IP4 0.0.0.0\na=rtcp-mux\n")
    assert muxed.control_port == 5004
    assert "a=rtcp-mux\r\n" in write_sdp(muxed)
    assert parse_sdp(write_sdp(muxed)) == muxed


def test_feedback_is_offered_with_its_profile_only():
    # RFC 4585 section 4.2: rtcp-fb is not for RTP/AVP. RFC 5506 section 5: nor is rtcp-rsize.
    plain = write_sdp(stream(reduced_size=True))
    assert "AVPF" not in plain and "rtcp-fb" not in plain and "rtcp-rsize" not in plain
    # A voice has no pictures to ask for.
    voice = stream(kind="audio", feedback=True, reduced_size=True)
    assert " RTP/AVPF 96\r\n" in write_sdp(voice) and "rtcp-fb" not in write_sdp(voice)
    for described in (voice, stream(feedback=True)):
        assert parse_sdp(write_sdp(described)) == described


def test_an_id_that_no_short_header_has_is_not_read():
    for line in ("15 {}", "0 {}", "x {}", "3"):
        assert read(f"a=extmap:{line}\n".format(CAPTURE_TIME)).capture_time_id is None
    assert read(f"a=extmap:3/sendonly {CAPTURE_TIME} x").capture_time_id == 3


@pytest.mark.parametrize(
    ("sets", "level"),
    [((PPS, SPS), "42C01E"), ((SPS[:3], PPS), None), ((b"\x67\x64\x00\x28\x01",), "640028")],
)
def test_the_level_is_that_of_the_first_whole_sps_unless_told(sets, level):
    text = write_sdp(stream(parameter_sets=sets))
    assert (f";profile-level-id={level};" in text) == ("profile-level-id" in text) == bool(level)
    assert parse_sdp(text).parameter_sets == sets
    assert "packetization-mode=1\r\n" in write_sdp(stream())
    # The usual one, or one cut short, is not kept.
    assert parse_sdp(text).profile_level_id == ""
    if level:
        assert parse_sdp(text.replace(level, level[:4])).profile_level_id == ""
        grown = stream(parameter_sets=sets, profile_level_id="42C01F")
        assert parse_sdp(write_sdp(grown)) == grown


def test_an_address_of_the_media_goes_before_that_of_the_session():
    assert read() == stream(name="Room")
    assert read("c=IN IP4 224.1.1.1/127\n").host == "224.1.1.1"
    # The address of a stream that is left out is not that of the next one.
    for address in ("10.0.0.9", "camera.local"):
        other = f"m=text 5000 RTP/AVP 98\nc=IN IP4 {address}\n"
        assert read(head=HEAD + other).host == "10.0.0.1"
    # RFC 8866 section 5.7: IPv4 needs a TTL of a group, IPv6 has none.
    assert "\r\nc=IN IP4 224.1.1.1/1\r\n" in write_sdp(stream(host="224.1.1.1"))
    assert "\r\nc=IN IP6 ff15::101\r\n" in write_sdp(stream(host="ff15::101"))
    # A receiver does not need the address, so neither a name nor its absence matters.
    assert read(head="v=0\n").host == "0.0.0.0"
    assert read("c=IN IP6 camera.local\n").host == "::"


def test_only_the_bandwidth_with_headers_is_the_cap():
    other = "b=TIAS:64000\nb=RR:0\na=AS:9\n"
    assert read(other).bandwidth_bps is None
    assert read(other + "b=AS:85\n").bandwidth_bps == 85_000
    # 50 packets of 20 octets of payload a second, with 40 octets of headers each; IPv6 has 60.
    assert session_bandwidth_bps(8_000, 50, "192.0.2.1") == 24_000
    assert session_bandwidth_bps(8_000, 50, "2001:db8::1") == 32_000


def test_the_first_known_payload_type_counts_with_its_own_parameters():
    text = (
        "m=video 5004/2 RTP/AVPF 96 97\r\na=rtpmap:96 VP8/90000\r\n"
        "a=rtpmap:97 H264/90000\r\na=fmtp:96 packetization-mode=2\r\n"
        'a=fmtp:97 packetization-mode=0; Sprop-Parameter-Sets="Z0LAHg==,aM48gA=="\r\n'
        "a=rtcp:7000 IN IP4 10.0.0.1\r\n"
    )
    assert read(media=text) == stream(
        name="Room", payload_type=97, rtcp_port=7000, parameter_sets=(SPS, PPS), feedback=True
    )
    # A voice is read in mono too.
    for encoding in ("opus/48000/2", "OPUS/48000", "opus/48000/1"):
        assert read(media=f"m=audio 5004 RTP/AVP 97\na=rtpmap:97 {encoding}\n").kind == "audio"


NO_STREAM = "no stream"
NO_KEYS = "takes no keys"


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (HEAD + VIDEO.replace("video", "audio"), NO_STREAM),
        (HEAD + VIDEO.replace("RTP/AVP", "TCP/RTP/AVP"), NO_STREAM),
        (HEAD + "m=video 5004 RTP/AVP\n", NO_STREAM),
        (HEAD + "m=video 5004 RTP/AVP 96\na=rtpmap:97 H264/90000\n", NO_STREAM),
        (HEAD, NO_STREAM),
        (VIDEO, "no SDP"),
        *(
            (HEAD + VIDEO.replace("RTP/AVP", profile), NO_KEYS)
            for profile in ("RTP/SAVP", "RTP/SAVPF", "UDP/TLS/RTP/SAVPF")
        ),
        (
            write_sdp(WRITTEN["HEVC"][0]).replace("sprop-vps", "sprop-max-don-diff=2;sprop-vps"),
            "decoding order",
        ),
    ],
)
def test_what_is_no_stream_of_ours_is_refused(text, reason):
    with pytest.raises(ConfigError, match=reason):
        parse_sdp(text)
    if reason == NO_KEYS:
        assert parse_sdp(text + VIDEO).port == 5004


def test_numbers_are_read_up_to_their_limits():
    media = "m=video {0} RTP/AVP {1}\na=rtpmap:{1} H264/90000\n"
    for port, kind in ((1, 0), (65534, 127)):
        found = read(media=media.format(port, kind))
        assert (found.port, found.payload_type) == (port, kind)
    for port, kind in ((0, 0), (1, -1), (65535, 0), (1, 128)):
        with pytest.raises(ConfigError, match="must be a whole number"):
            read(media=media.format(port, kind))


@pytest.mark.parametrize(
    "line",
    [
        *("b=AS:0", "b=AS:", "b=AS:many", "a=rtcp:0", "a=rtcp:70000", "a=rtcp:", "a=rtpmap:"),
        *("colour", "X-vendor: 1", "=x", "ab=x", " folded=1", "a=fmtp:96", "c="),
        *(f"a=fmtp:96 sprop-parameter-sets={sets}" for sets in ("", "!", ",", "QQ==", "6QDwBE8=")),
    ],
)
def test_what_is_malformed_and_not_needed_is_ignored(line):
    text = f"{HEAD}{line}\n{VIDEO}{line}\nm=audio 5006 RTP/AVP 8\n{line}\n"
    for ends in ("\n", "\r\n", "\r"):
        found = parse_sdp(text.replace("\n", ends) + "\0")
        assert found == stream(name="Room", host="0.0.0.0" if line == "c=" else "10.0.0.1")


@pytest.mark.parametrize(
    "sets",
    [
        *("Z0LAHg==,aM48gA==,", "Z0LAHg,aM48gA", "Z0LAHg==, aM48gA==", "Z0LAHg==,aM48gA==,BgU="),
        *("AAAAAWdCwB4=,AAAAAWjOPIA=", "AAABZ0LAHgAAAWjOPIA="),
    ],
)
def test_parameter_sets_are_found_in_what_cameras_write(sets):
    found = read(f"a=fmtp: 96 packetization-mode=1 ; sprop-parameter-sets={sets}\n")
    assert found.parameter_sets == (SPS, PPS)


@given(
    st.sampled_from(["", "SDP:\n", "RTSP/1.0 200 OK\r\nCSeq: 2\r\n\r\n", "\ufeff SDP:\n"]),
    st.sampled_from(
        ["", "m=video 0 RTP/AVP 97\na=rtpmap:97 H264/90000\n", "m=audio 0 RTP/AVP (x)\n"]
    ),
    st.sampled_from(["RTP/AVP", "rtp/avp", "udp", "RTP/AVP/UDP", "RTP/AVP/UDP;unicast"]),
    st.sampled_from([" ", "\t", "  "]),
    st.sampled_from(["H264/90000", "h264/90000/1", "H264", "H264/9000"]),
    st.sampled_from(["", "packetization-mode=2", "profile-level-id=ffffc016", "profile-level-id="]),
)
def test_what_ffmpeg_plays_is_read(head, rejected, profile, blank, encoding, formats):
    text = f"m=video 5004 {profile} 96\na=rtpmap: 96{blank}{encoding}\na=fmtp:96 {formats}\n"
    found = parse_sdp(head + HEAD + rejected + text + "b=AS: 2048.5\n")
    assert found == stream(name="Room", bandwidth_bps=2_048_000)


def test_the_senders_of_a_group_are_read():
    head = HEAD + "a=source-filter: incl IN IP4 * 192.0.2.1\n"
    assert read(head=head).sources == ("192.0.2.1",)
    own = "a=source-filter:incl IN IP4 239.1.2.3 192.0.2.2 192.0.2.3\n"
    assert read(own, head=head).sources == ("192.0.2.2", "192.0.2.3")
    for line in ("excl IN IP4 * 192.0.2.2", "incl IN IP4 * camera.local", "incl", ""):
        assert read(f"a=source-filter:{line}\n").sources == ()
