"""Octets derived by hand from the standards, so that errors in both directions cannot cancel."""

import pytest
from rtp_packets import PromptSender

from kontur_av.errors import ConfigError, ProtocolError
from kontur_av.media import AccessUnit, CaptureStamp
from kontur_av.rtp.annex_b import split_annex_b
from kontur_av.rtp.nal_formats import H264, H265
from kontur_av.rtp.payload_opus import opus_samples
from kontur_av.rtp.sdp import StreamDescription, parse_sdp, write_sdp
from kontur_av.rtp.wire import TimestampUnwrapper, parse_rtcp, parse_rtp

SPS = bytes.fromhex("6742c01e")
PPS = bytes.fromhex("68ce3c80")
IDR = bytes.fromhex("6588840102030405060708090a0b")


def sender(**changes) -> PromptSender:
    return PromptSender(
        **{
            "payload_type": 96,
            "clock_rate_hz": 90_000,
            "ssrc": 0xDEADBEEF,
            "first_sequence": 0x1234,
            "timestamp_offset": 0x01000000,
            "cname": "robot",
        }
        | changes
    )


def test_an_rtp_packet_octet_for_octet():
    # 1 s after the epoch of the clock: 90000 = 0x15F90 ticks after the offset.
    stamp = CaptureStamp(1_000_000_000, 0, "left")
    unit = AccessUnit(b"\x00\x00\x00\x01\x41\x9a\x55", stamp, False)
    (packet,) = sender().video_packets(unit).packets
    # V=2, no padding, extension or CSRC | marker, type 96 | sequence | timestamp | SSRC | NAL unit
    assert packet == bytes.fromhex("80 e0 1234 01015f90 deadbeef 419a55")


def test_a_sender_report_octet_for_octet():
    rtp = sender()
    capture_ns = 1_500_000_000  # 1.5 s after 1970: NTP 2208988801.5
    rtp.video_packets(
        AccessUnit(b"\x00\x00\x01\x41\x9a\x55", CaptureStamp(capture_ns, 0, "left"), False)
    )
    assert rtp.poll_report(capture_ns) == bytes.fromhex(
        "80 c8 0006 deadbeef"  # V=2, no report blocks, SR, 7 words
        "83aa7e81 80000000"  # NTP: 2208988801 s and a half
        "01020f58"  # RTP: 0x01000000 + 135000
        "00000001 00000003"  # one packet, three octets
        "81 ca 0003 deadbeef"  # V=2, one chunk, SDES, 4 words in all
        "01 05 726f626f74 00"  # CNAME "robot", end, padded to a word
    )


def test_small_nal_units_share_a_stap_a():
    (payload,) = H264.packetize([SPS, PPS, IDR])
    # F=0, NRI=3, type 24; then a length of 16 bits before each
    assert payload == bytes.fromhex("78 0004 6742c01e 0004 68ce3c80 000e") + IDR


def test_a_large_nal_unit_is_cut_into_fu_a():
    assert H264.packetize([IDR], max_payload_octets=8) == [
        # FU indicator: NRI=3, type 28; FU header: start, -, end | type 5; NAL header is left out
        bytes.fromhex("7c 85 88840102"),
        bytes.fromhex("7c 05 03040506"),
        bytes.fromhex("7c 45 0708090a0b"),
    ]


def test_fu_a_restores_the_nal_header():
    first = H264.parse_payload(bytes.fromhex("7c858884"))
    assert (first.nal_units, first.starts, first.ends) == ((bytes.fromhex("658884"),), True, False)


def test_annex_b_with_start_codes_of_both_lengths_and_trailing_zeros():
    stream = b"\x00\x00\x00\x01" + SPS + b"\x00\x00\x01" + PPS + b"\x00\x00\x00\x01" + IDR + b"\x00"
    assert split_annex_b(stream) == [SPS, PPS, IDR]


def test_padding_extension_and_csrc_are_no_payload():
    packet = parse_rtp(
        bytes.fromhex(
            "b1 60 0001 00000002 00000003"  # V=2, P, X, one CSRC
            "00000004"  # CSRC
            "bede0001 10ff0000"  # RFC 8285 extension of one word
            "4142 000003"  # payload, 3 octets of padding
        )
    )
    assert (packet.payload, packet.sequence_number) == (b"AB", 1)


@pytest.mark.parametrize(
    ("toc", "samples"),
    [
        ("08", 960),  # config 1, SILK NB 20 ms, one frame
        ("18", 2880),  # config 3, SILK NB 60 ms
        ("78", 960),  # config 15, hybrid FB 20 ms
        ("e0", 120),  # config 28, CELT FB 2.5 ms
        ("f9", 1920),  # config 31, CELT FB 20 ms, two frames
        ("fb06", 5760),  # six frames: 120 ms
    ],
)
def test_the_length_of_an_opus_packet(toc, samples):
    assert opus_samples(bytes.fromhex(toc)) == samples


def test_sdp_of_a_video_stream():
    stream = StreamDescription(
        kind="video",
        host="127.0.0.1",
        port=5004,
        payload_type=96,
        bandwidth_bps=85_000,
        parameter_sets=(SPS, PPS),
        profile_level_id="42C015",
        feedback=True,
        reduced_size=True,
        capture_time_id=1,
    )
    assert write_sdp(stream).splitlines() == [
        "v=0",
        "o=- 0 0 IN IP4 127.0.0.1",
        "s=kontur-av",
        "c=IN IP4 127.0.0.1",
        "t=0 0",
        "m=video 5004 RTP/AVPF 96",
        "b=AS:85",
        "a=rtpmap:96 H264/90000",
        "a=fmtp:96 packetization-mode=1;profile-level-id=42C015;"
        "sprop-parameter-sets=Z0LAHg==,aM48gA==",
        "a=rtcp-fb:96 nack pli",
        "a=rtcp-rsize",
        "a=extmap:1 http://www.webrtc.org/experiments/rtp-hdrext/abs-capture-time",
        "a=recvonly",
    ]
    assert parse_sdp(write_sdp(stream)) == stream


def test_sdp_written_by_ffmpeg_is_understood():
    text = (
        "SDP:\nv=0\no=- 0 0 IN IP4 127.0.0.1\ns=No Name\nc=IN IP4 127.0.0.1\nt=0 0\n"
        "a=tool:libavformat 59.27.100\nm=video 6000 RTP/AVP 96\nb=AS:200\n"
        "a=rtpmap:96 H264/90000\na=fmtp:96 packetization-mode=1\n"
    )
    stream = parse_sdp(text)
    assert (stream.port, stream.bandwidth_bps, stream.control_port) == (6000, 200_000, 6001)


VPS_265, SPS_265 = bytes.fromhex("40010c01ffff"), bytes.fromhex("420101016090")
PPS_265, IDR_265 = bytes.fromhex("4401c172b0"), bytes.fromhex("2601af0102030405060708090a")


def test_small_nal_units_of_hevc_share_an_aggregation_packet():
    (payload,) = H265.packetize([VPS_265, SPS_265, PPS_265])
    # RFC 7798 section 4.4.2: F=0, type 48, layer 0, TID 1; then a length of 16 bits before each
    assert payload == bytes.fromhex("6001 0006 40010c01ffff 0006 420101016090 0005 4401c172b0")
    assert H265.parse_payload(payload).nal_units == (VPS_265, SPS_265, PPS_265)


def test_an_aggregation_packet_of_hevc_has_the_lowest_layer_and_any_forbidden_bit():
    # Layer 33 with TID 3, and layer 2 with TID 2 and the forbidden bit.
    (payload,) = H265.packetize([bytes.fromhex("030b11"), bytes.fromhex("821222")])
    assert payload[:2] == bytes.fromhex("e012")


def test_a_large_nal_unit_of_hevc_is_cut_into_fragmentation_units():
    payloads = H265.packetize([IDR_265], 8)
    # Section 4.4.3: the header with type 49, then S, E and the original type 19
    assert payloads == [
        bytes.fromhex("6201 93 af0102"),
        bytes.fromhex("6201 13 03040506"),
        bytes.fromhex("6201 53 0708090a"),
    ]
    first = H265.parse_payload(payloads[0])
    assert (first.is_part, first.starts, first.ends) == (True, True, False)
    assert first.nal_units[0][:2] == IDR_265[:2]


@pytest.mark.parametrize("octets", ["", "62", "6201", "6401ff", "6001000526", "7e01aa", "2600"])
def test_payloads_that_are_no_hevc_are_refused(octets):
    with pytest.raises(ProtocolError):
        H265.parse_payload(bytes.fromhex(octets))


def test_the_sdp_of_hevc():
    stream = StreamDescription(
        kind="video",
        codec="h265",
        host="192.0.2.7",
        port=5004,
        payload_type=96,
        parameter_sets=(VPS_265, SPS_265, PPS_265),
    )
    text = write_sdp(stream)
    assert "a=rtpmap:96 H265/90000\r\n" in text
    assert "a=fmtp:96 sprop-vps=QAEMAf//;sprop-sps=QgEBAWCQ;sprop-pps=RAHBcrA=\r\n" in text
    assert parse_sdp(text) == stream
    with pytest.raises(ConfigError, match="decoding order"):
        parse_sdp(text.replace("sprop-vps", "sprop-max-don-diff=2;sprop-vps"))


def test_a_compound_packet_is_read_as_far_as_it_is_well_formed():
    report, goodbye = bytes.fromhex("80c90001 00000001"), bytes.fromhex("81cb0001 00000002")
    kinds = [type(one).__name__ for one in parse_rtcp(report + goodbye)]
    assert kinds == ["RtcpRrPacket", "RtcpByePacket"]
    # A length beyond the end means the rest, and what follows a good packet may be malformed.
    for behind in (b"\x81\xcb\0\x09\0\0\0\2", goodbye + b"\x81", goodbye + bytes(8)):
        assert [type(one).__name__ for one in parse_rtcp(report + behind)] == kinds
    for octets in (b"", b"\x80", bytes(12)):
        with pytest.raises(ProtocolError):
            parse_rtcp(octets)


def test_packets_that_are_no_rtp_are_refused():
    packet = bytes.fromhex("80e00001 00000002 00000003 41")
    assert parse_rtp(packet).marker == 1
    for octets in (packet[:11], b"\x40" + packet[1:], b"\xc0" + packet[1:], b"\x81" + packet[1:]):
        with pytest.raises(ProtocolError, match="not an RTP packet"):
            parse_rtp(octets)


def test_timestamps_are_counted_on_across_their_end():
    unwrapper = TimestampUnwrapper()
    first = 2**32 - 10
    ticks = [0, 5, 3, 2**31, 2**31 + 100, 2**32 + 5, 2**32]
    assert [unwrapper.unwrap((first + one) % 2**32) for one in ticks] == ticks
