"""What is written into a session description, and what is read from those of other programs."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from kontur_av.errors import ConfigError
from kontur_av.rtp.sdp import StreamDescription, parse_sdp, session_bandwidth_bps, write_sdp

SPS, PPS = b"\x67\x42\xc0\x1e", b"\x68\xce\x3c\x80"
HEAD = "v=0\ns=Room\nc=IN IP4 10.0.0.1\nt=0 0\n"
VIDEO = "m=video 5004 RTP/AVP 96\na=rtpmap:96 H264/90000\n"


def stream(**changes) -> StreamDescription:
    values = {"kind": "video", "host": "10.0.0.1", "port": 5004, "payload_type": 96} | changes
    return StreamDescription(**values)


def test_sdp_of_a_voice():
    voice = stream(kind="audio", host="::1", payload_type=97, rtcp_port=6001, bandwidth_bps=8_001)
    assert write_sdp(voice).splitlines() == [
        "v=0",
        "o=- 0 0 IN IP6 ::1",
        "s=kontur-av",
        "c=IN IP6 ::1",
        "t=0 0",
        "m=audio 5004 RTP/AVP 97",
        "b=AS:9",
        "a=rtcp:6001",
        "a=rtpmap:97 opus/48000/2",
        "a=fmtp:97 stereo=0;sprop-stereo=0;cbr=1",
        "a=ptime:20",
        "a=recvonly",
    ]
    assert (voice.clock_rate_hz, voice.control_port) == (48_000, 6001)


def test_feedback_is_offered_with_its_profile_only():
    # RFC 4585 section 4.2: rtcp-fb is not for RTP/AVP. RFC 5506 section 5: nor is rtcp-rsize.
    plain = write_sdp(stream(reduced_size=True))
    assert "AVPF" not in plain and "rtcp-fb" not in plain and "rtcp-rsize" not in plain
    for description in (
        stream(feedback=True),
        stream(feedback=True, reduced_size=True, capture_time_id=14),
        stream(kind="audio", feedback=True, reduced_size=True),
    ):
        text = write_sdp(description)
        assert f" RTP/AVPF {description.payload_type}\r\n" in text
        # A voice has no pictures to ask for.
        assert ("a=rtcp-fb:96 nack pli" in text) == (description.kind == "video")
        assert parse_sdp(text) == description


@pytest.mark.parametrize("line", ["a=extmap:15 {}", "a=extmap:0 {}", "a=extmap:x {}", "a=extmap:3"])
def test_an_id_that_no_short_header_has_is_not_read(line):
    address = "http://www.webrtc.org/experiments/rtp-hdrext/abs-capture-time"
    assert parse_sdp(HEAD + VIDEO + line.format(address)).capture_time_id is None
    assert parse_sdp(HEAD + VIDEO + f"a=extmap:3/sendonly {address} x").capture_time_id == 3


def test_the_usual_control_port_is_not_written():
    assert "a=rtcp:" not in write_sdp(stream(rtcp_port=5005))
    assert (stream().clock_rate_hz, stream().control_port) == (90_000, 5005)


@pytest.mark.parametrize(
    ("sets", "level"),
    [((PPS, SPS), "42C01E"), ((SPS[:3], PPS), None), ((b"\x67\x64\x00\x28\x01",), "640028")],
)
def test_the_level_is_that_of_the_first_whole_sps(sets, level):
    text = write_sdp(stream(parameter_sets=sets))
    assert (f";profile-level-id={level};" in text) == ("profile-level-id" in text) == bool(level)
    assert parse_sdp(text).parameter_sets == sets
    assert "packetization-mode=1\r\n" in write_sdp(stream())


def test_an_address_of_the_media_goes_before_that_of_the_session():
    assert parse_sdp(HEAD + VIDEO) == stream(name="Room")
    own = parse_sdp(HEAD + VIDEO + "c=IN IP4 224.1.1.1/127\n")
    assert own.host == "224.1.1.1"
    # The address of a stream that is left out is not that of the next one.
    other = "m=text 5000 RTP/AVP 98\nc=IN IP4 10.0.0.9\n"
    assert parse_sdp(HEAD + other + VIDEO).host == "10.0.0.1"
    # A receiver does not need the address, so neither a name nor its absence matters.
    assert parse_sdp("v=0\n" + VIDEO).host == "0.0.0.0"
    assert parse_sdp(HEAD + VIDEO + "c=IN IP6 camera.local\n").host == "::"
    name = "m=text 5000 RTP/AVP 98\nc=IN IP4 camera.local\n"
    assert parse_sdp(HEAD + name + VIDEO).host == "10.0.0.1"


def test_only_the_bandwidth_with_headers_is_the_cap():
    other = "b=TIAS:64000\nb=RR:0\na=AS:9\n"
    assert parse_sdp(HEAD + VIDEO + other).bandwidth_bps is None
    assert parse_sdp(HEAD + VIDEO + other + "b=AS:85\n").bandwidth_bps == 85_000


def test_the_first_known_payload_type_counts_with_its_own_parameters():
    text = (
        "m=video 5004/2 RTP/AVPF 96 97\r\na=rtpmap:96 VP8/90000\r\n"
        "a=rtpmap:97 H264/90000\r\na=fmtp:96 packetization-mode=2\r\n"
        'a=fmtp:97 packetization-mode=0; Sprop-Parameter-Sets="Z0LAHg==,aM48gA=="\r\n'
        "a=rtcp:7000 IN IP4 10.0.0.1\r\n"
    )
    assert parse_sdp(HEAD + text) == stream(
        name="Room", payload_type=97, rtcp_port=7000, parameter_sets=(SPS, PPS), feedback=True
    )


@pytest.mark.parametrize("encoding", ["opus/48000/2", "OPUS/48000", "opus/48000/1"])
def test_a_voice_is_read_in_mono_too(encoding):
    text = f"{HEAD}m=audio 5004 RTP/AVP 97\na=rtpmap:97 {encoding}\n"
    assert parse_sdp(text).kind == "audio"


@pytest.mark.parametrize(
    "text",
    [
        VIDEO.replace("video", "audio"),
        VIDEO.replace("RTP/AVP", "TCP/RTP/AVP"),
        "m=video 5004 RTP/AVP\n",
        "m=video 5004 RTP/AVP 96\na=rtpmap:97 H264/90000\n",
        "",
    ],
)
def test_what_is_no_stream_of_ours_is_refused(text):
    with pytest.raises(ConfigError, match="no stream"):
        parse_sdp(HEAD + text)


@pytest.mark.parametrize(
    ("port", "payload_type"),
    [(1, 0), (65534, 127)],
)
def test_numbers_are_read_up_to_their_limits(port, payload_type):
    def described(port, payload_type):
        return parse_sdp(
            f"{HEAD}m=video {port} RTP/AVP {payload_type}\na=rtpmap:{payload_type} H264/90000\n"
        )

    right = (port, payload_type)
    found = described(*right)
    assert (found.port, found.payload_type) == (port, payload_type)
    step = 1 if port > 1 else -1
    for field in range(2):
        wrong = list(right)
        wrong[field] += step
        with pytest.raises(ConfigError, match="must be a whole number"):
            described(*wrong)


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
    text = f"{HEAD}{VIDEO}a=fmtp: 96 packetization-mode=1 ; sprop-parameter-sets={sets}\n"
    assert parse_sdp(text).parameter_sets == (SPS, PPS)


def test_numbers_that_are_nearly_right_are_read():
    text = HEAD + VIDEO.replace("rtpmap:", "rtpmap: ").replace("RTP/AVP", "udp")
    assert parse_sdp(text + "b=AS: 2048.5\n").bandwidth_bps == 2_048_000


def test_reports_may_come_to_the_port_of_the_media():
    text = f"{HEAD}{VIDEO}a=rtcp:9 IN IP4 0.0.0.0\na=rtcp-mux\n"
    assert parse_sdp(text).control_port == 5004
    assert "a=rtcp-mux\r\n" in write_sdp(parse_sdp(text))
    assert parse_sdp(write_sdp(parse_sdp(text))) == parse_sdp(text)


@pytest.mark.parametrize("profile", ["RTP/SAVP", "RTP/SAVPF", "UDP/TLS/RTP/SAVPF"])
def test_an_encrypted_stream_is_refused_with_a_word_about_keys(profile):
    encrypted = VIDEO.replace("RTP/AVP", profile)
    with pytest.raises(ConfigError, match="takes no keys"):
        parse_sdp(HEAD + encrypted)
    assert parse_sdp(HEAD + encrypted + VIDEO).port == 5004


def test_a_multicast_address_is_written_with_its_ttl():
    # RFC 8866 section 5.7: IPv4 needs one, IPv6 has none.
    assert "\r\nc=IN IP4 224.1.1.1/1\r\n" in write_sdp(stream(host="224.1.1.1"))
    assert "\r\nc=IN IP6 ff15::101\r\n" in write_sdp(stream(host="ff15::101"))


def test_text_that_is_no_description_is_refused():
    with pytest.raises(ConfigError, match="no SDP"):
        parse_sdp(VIDEO)
    # As ffmpeg prints it, and as Windows stores it.
    assert parse_sdp("\ufeff SDP:\n" + HEAD + VIDEO) == stream(name="Room")


@given(
    st.sampled_from(["", "SDP:\n", "RTSP/1.0 200 OK\r\nCSeq: 2\r\n\r\n", "\ufeff \n"]),
    st.sampled_from(
        ["", "m=video 0 RTP/AVP 97\na=rtpmap:97 H264/90000\n", "m=audio 0 RTP/AVP (x)\n"]
    ),
    st.sampled_from(["RTP/AVP", "rtp/avp", "udp", "RTP/AVP/UDP", "RTP/AVP/UDP;unicast"]),
    st.sampled_from([" ", "\t", "  "]),
    st.sampled_from(["H264/90000", "h264/90000/1", "H264", "H264/9000"]),
    st.sampled_from(["", "packetization-mode=2", "profile-level-id=ffffc016", "profile-level-id="]),
)
def test_what_ffmpeg_plays_is_read(head, rejected, profile, blank, encoding, formats):
    text = f"m=video 5004 {profile} 96\na=rtpmap:96{blank}{encoding}\na=fmtp:96 {formats}\n"
    assert parse_sdp(head + HEAD + rejected + text) == stream(name="Room")


def test_the_bandwidth_has_the_headers_of_ip_udp_and_rtp():
    # 50 packets of 20 octets of payload a second, with 40 octets of headers each; IPv6 has 60.
    assert session_bandwidth_bps(8_000, 50, "192.0.2.1") == 24_000
    assert session_bandwidth_bps(8_000, 50, "2001:db8::1") == 32_000


def test_a_level_above_that_of_the_parameter_sets_is_kept():
    grown = stream(parameter_sets=(SPS, PPS), profile_level_id="42C01F")
    assert parse_sdp(write_sdp(grown)) == grown
    usual = write_sdp(stream(parameter_sets=(SPS, PPS)))
    assert parse_sdp(usual).profile_level_id == ""
    assert parse_sdp(usual.replace("42C01E", "42c0")).profile_level_id == ""


def test_the_senders_of_a_group_are_read():
    head = HEAD + "a=source-filter: incl IN IP4 * 192.0.2.1\n"
    assert parse_sdp(head + VIDEO).sources == ("192.0.2.1",)
    own = "a=source-filter:incl IN IP4 239.1.2.3 192.0.2.2 192.0.2.3\n"
    assert parse_sdp(head + VIDEO + own).sources == ("192.0.2.2", "192.0.2.3")
    for line in ("excl IN IP4 * 192.0.2.2", "incl IN IP4 * camera.local", "incl", ""):
        assert parse_sdp(HEAD + VIDEO + f"a=source-filter:{line}\n").sources == ()
