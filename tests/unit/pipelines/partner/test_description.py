"""Offers and answers: what a browser says, what is refused, and garbage."""

import re

import pytest

from kontur_av.errors import ProtocolError
from kontur_av.rtp.header_extensions import ABS_SEND_TIME, MID, PLAYOUT_DELAY
from pipelines.partner import description

SSRCS = {"audio": 11, "video": 22}
LOCAL = description.Transport(
    ufrag="abcd",
    password="0123456789012345678901",
    fingerprints=(("sha-256", ":".join(["AB"] * 32)),),
    role="client",
)
WAY = f"""a=ice-ufrag:peer
a=ice-pwd:peerpeerpeerpeerpeerpeer
a=fingerprint:sha-256 {":".join(["CD"] * 32)}
a=setup:actpass"""
#: What Chromium offers, shortened: VP8 before H.264, a picture twice, a data channel.
BROWSER = f"""v=0
o=- 1 2 IN IP4 127.0.0.1
s=-
t=0 0
a=group:BUNDLE 0 1 2
a=extmap-allow-mixed
m=audio 9 UDP/TLS/RTP/SAVPF 111
c=IN IP4 0.0.0.0
{WAY}
a=ice-options:trickle
a=mid:0
a=extmap:1 urn:ietf:params:rtp-hdrext:ssrc-audio-level
a=extmap:4 {MID}
a=sendrecv
a=rtcp-mux
a=rtpmap:111 opus/48000/2
a=fmtp:111 minptime=10;useinbandfec=1
a=ssrc:77 cname:x
m=video 9 UDP/TLS/RTP/SAVPF 96 97 102 103 106
c=IN IP4 0.0.0.0
{WAY}
a=mid:1
a=extmap:2 {ABS_SEND_TIME}
a=extmap:5 {PLAYOUT_DELAY}
a=extmap:4 {MID}
a=recvonly
a=rtcp-mux
a=rtpmap:96 VP8/90000
a=rtpmap:97 rtx/90000
a=fmtp:97 apt=96
a=rtpmap:102 H264/90000
a=rtcp-fb:102 nack pli
a=fmtp:102 level-asymmetry-allowed=1;packetization-mode=1;profile-level-id=42001f
a=rtpmap:103 H264/90000
a=fmtp:103 level-asymmetry-allowed=1;packetization-mode=0;profile-level-id=42e01f
a=rtpmap:106 H264/90000
a=rtcp-fb:106 nack
a=fmtp:106 level-asymmetry-allowed=1;packetization-mode=1;profile-level-id=42e01f
m=application 9 UDP/DTLS/SCTP webrtc-datachannel
c=IN IP4 0.0.0.0
{WAY}
a=mid:2
a=sctp-port:5000
""".replace("\n", "\r\n")


def read(text=BROWSER, *, answers=False):
    return description.read_description(text, answers=answers, ssrcs=SSRCS)


def described(lines, **options):
    return description.write_description(lines, LOCAL, session=1, cname="c", stream="s", **options)


def candidate(address, port, foundation="1"):
    return f"a=candidate:{foundation} 1 udp 2130706431 {address} {port} typ host"


def test_a_browsers_offer_is_answered_with_what_both_can():
    offer = read()
    audio, video = offer.lines
    assert (audio.payload_type, audio.sends, audio.receives) == (111, True, True)
    assert audio.peer_ssrc == 77
    # Constrained baseline in fragments, though others stand before it.
    assert (video.payload_type, video.sends, video.receives) == (106, True, False)
    text = described([description.common_line(video, sends=True, receives=True)], answers=offer)
    # The sections stay in order; those not wanted are refused by port 0.
    sections = [part.split()[0:2] for part in text.split("m=")[1:]]
    assert sections == [["audio", "0"], ["video", "9"], ["application", "0"]]
    assert "a=group:BUNDLE 1\r\n" in text
    (theirs,) = read(text, answers=True).lines
    assert (theirs.payload_type, theirs.receives, theirs.peer_ssrc) == (106, True, 22)
    assert theirs.extensions == {MID: 4, ABS_SEND_TIME: 2, PLAYOUT_DELAY: 5}
    assert theirs.feedback == {"nack"}


def test_our_offer_comes_back_as_it_was_and_a_parameter_without_its_value_is_not_repeated():
    lines = [
        description.wanted_line("audio", mid="0", ssrc=1, sends=True),
        description.wanted_line("video", mid="1", ssrc=2, sends=True, receives=True),
    ]
    audio, video = read(described(lines)).lines
    assert (audio.sends, audio.receives) == (False, True)
    assert (video.sends, video.receives, video.peer_ssrc) == (True, True, 2)
    # What the partner does not take is not sent.
    line = description.wanted_line("video", mid="1", ssrc=1, receives=True)
    assert description.common_line(line, sends=True, receives=False) is None
    offer = read(re.sub("profile-level-id=[0-9a-f]+", "profile-level-id=", BROWSER))
    line = description.common_line(offer.lines[1], sends=True, receives=True)
    answer = described([line], answers=offer)
    assert "packetization-mode=1" in answer and "profile-level-id" not in answer
    bare = re.sub("packetization-mode=.;", "", BROWSER.replace("actpass", "active"))
    assert "packetization-mode" not in bare
    assert "video" in [line.kind for line in read(bare, answers=True).lines]


@pytest.mark.rule("10")
def test_what_cannot_be_used_or_is_endless_is_refused_and_what_is_not_needed_refuses_nothing():
    # Garbage: tests/fuzz/test_strangers_fuzz.py.
    for left_out, why in (
        *(("a=fingerprint", "fingerprint"), ("a=ice-pwd", "password"), ("a=rtpmap", "not a sess")),
        *(("a=rtcp-mux", "no bundled"), ("a=group", "no bundled")),
    ):
        lines = [line for line in BROWSER.split("\r\n") if not line.startswith(left_out)]
        with pytest.raises(ProtocolError, match=why):
            read("\r\n".join(lines))
    with pytest.raises(ProtocolError, match="octets"):
        read("a" * (description.MOST_SDP_OCTETS + 1))
    for line in (
        *("a=fmtp:96", "a=fmtp:18 annexb=no", "a=fmtp:", "a=rtcp-fb:96", "a=rtcp-fb:*"),
        *("a=ssrc:7", "a=ssrc:7 cname", "a=ssrc:x cname:y", "a=ssrc-group:FID 1 x"),
        *("a=extmap:9 urn:x some more", "a=extmap:x urn:x", "a=extmap-allow-mixed"),
    ):
        assert read(BROWSER.replace("a=mid:1\r\n", f"a=mid:1\r\n{line}\r\n")) == read(), line


def test_candidates_travel_in_fragments_and_in_the_first_section_whether_it_is_wanted_or_not():
    assert (
        description.read_candidates(description.write_candidates(read().transport, mid="0")).ufrag
        == "peer"
    )
    told = description.read_candidates(
        "a=ice-ufrag:u\r\na=ice-pwd:p\r\nm=audio 9 RTP/AVP 0\r\na=mid:0\r\n"
        f"{candidate('192.0.2.1', 3456)}\r\na=end-of-candidates\r\n"
    )
    assert (told.ufrag, told.candidates[0].port, told.complete) == ("u", 3456, True)
    with pytest.raises(ProtocolError, match="user name"):
        description.read_candidates(candidate("192.0.2.1", 3))
    with pytest.raises(ProtocolError, match="candidate"):
        description.read_candidates("a=ice-ufrag:u\r\na=ice-pwd:p\r\na=candidate:nonsense")
    # Cameras by Google write one without a foundation.
    for foundation in ("1", ""):
        line = candidate("192.0.2.1", 19305, foundation)
        text = BROWSER.replace("a=mid:0\r\n", f"a=mid:0\r\n{line}\r\n")
        offer = read(text.replace("opus/48000", "speex/16000"))
        assert [line.kind for line in offer.lines] == ["video"]
        assert [(one.ip, one.port) for one in offer.transport.candidates] == [("192.0.2.1", 19305)]


def test_a_candidate_that_no_datagram_may_go_to_is_left_out_and_loopback_is_for_this_machine():
    ports = [("192.0.2.1", port) for port in (70_000, -1, 0, "9" * 400)]
    hosts = ("224.0.0.1", "255.255.255.255", "0.0.0.0", "::", "nobody")
    for address, port in (*ports, *((host, 5000) for host in hosts)):
        line = candidate(address, port)
        text = "\r\n".join([BROWSER.rstrip("\r\n"), line, ""])
        assert description.clean_candidates(text) == BROWSER
        assert read(text).transport.candidates == ()
        fragment = f"a=ice-ufrag:a\r\na=ice-pwd:b\r\n{line}\r\n"
        assert description.read_candidates(fragment).candidates == ()
    local = ["127.0.0.1", "127.9.9.9", "::1", "::ffff:127.0.0.1"]
    far = ["192.0.2.1", f"{'a' * 8}-{'b' * 27}.local"]
    text = "\n".join(candidate(address, 5000) for address in (*local, *far))
    assert description.clean_candidates(text) == text
    kept = "\n".join(candidate(address, 5000) for address in far)
    assert description.clean_candidates(text, loopback=False) == kept


@pytest.mark.parametrize("turned", [False, True])
def test_of_two_pictures_that_is_taken_whose_direction_is_wanted(turned):
    # Some offer one picture to send and one to receive, each in a section of its own.
    lines = [
        description.wanted_line("video", mid="a", ssrc=1, sends=True),
        description.wanted_line("video", mid="b", ssrc=2, receives=True),
        description.wanted_line("video", mid="c", ssrc=3, sends=True, receives=True),
    ]
    offered = read(described(lines[::-1] if turned else lines)).lines
    (taken,) = description.common_lines(offered, sends={}, receives=("audio", "video"))
    assert (taken.mid, taken.sends, taken.receives) == ("c" if turned else "a", False, True)
    (given,) = description.common_lines(offered, sends={"video": 1}, receives=())
    assert (given.mid, given.sends, given.receives) == ("c" if turned else "b", True, False)
    assert description.common_lines(offered, sends={"audio": 1}, receives=("audio",)) == []
