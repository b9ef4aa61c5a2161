"""Offers and answers: what a browser says, what is refused, and garbage."""

import contextlib
import re

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kontur_av.errors import ProtocolError
from kontur_av.rtp.header_extensions import ABS_SEND_TIME, MID, PLAYOUT_DELAY
from pipelines.partner.description import (
    MOST_SDP_OCTETS,
    Transport,
    clean_candidates,
    common_line,
    common_lines,
    read_candidates,
    read_description,
    wanted_line,
    write_candidates,
    write_description,
)

SSRCS = {"audio": 11, "video": 22}
LOCAL = Transport(
    ufrag="abcd",
    password="0123456789012345678901",
    fingerprints=(("sha-256", ":".join(["AB"] * 32)),),
    role="client",
)
#: What Chromium offers, shortened: VP8 before H.264, a picture twice, a data channel.
BROWSER = "\r\n".join(
    [
        "v=0",
        "o=- 1 2 IN IP4 127.0.0.1",
        "s=-",
        "t=0 0",
        "a=group:BUNDLE 0 1 2",
        "a=extmap-allow-mixed",
        "a=msid-semantic: WMS",
        "m=audio 9 UDP/TLS/RTP/SAVPF 111 63 0",
        "c=IN IP4 0.0.0.0",
        "a=rtcp:9 IN IP4 0.0.0.0",
        "a=ice-ufrag:peer",
        "a=ice-pwd:peerpeerpeerpeerpeerpeer",
        "a=ice-options:trickle",
        "a=fingerprint:sha-256 " + ":".join(["CD"] * 32),
        "a=setup:actpass",
        "a=mid:0",
        "a=extmap:1 urn:ietf:params:rtp-hdrext:ssrc-audio-level",
        f"a=extmap:4 {MID}",
        "a=sendrecv",
        "a=rtcp-mux",
        "a=rtcp-rsize",
        "a=rtpmap:111 opus/48000/2",
        "a=rtcp-fb:111 transport-cc",
        "a=fmtp:111 minptime=10;useinbandfec=1",
        "a=rtpmap:63 red/48000/2",
        "a=fmtp:63 111/111",
        "a=rtpmap:0 PCMU/8000",
        "a=ssrc:77 cname:x",
        "m=video 9 UDP/TLS/RTP/SAVPF 96 97 102 103 106",
        "c=IN IP4 0.0.0.0",
        "a=ice-ufrag:peer",
        "a=ice-pwd:peerpeerpeerpeerpeerpeer",
        "a=fingerprint:sha-256 " + ":".join(["CD"] * 32),
        "a=setup:actpass",
        "a=mid:1",
        f"a=extmap:2 {ABS_SEND_TIME}",
        f"a=extmap:5 {PLAYOUT_DELAY}",
        f"a=extmap:4 {MID}",
        "a=recvonly",
        "a=rtcp-mux",
        "a=rtpmap:96 VP8/90000",
        "a=rtpmap:97 rtx/90000",
        "a=fmtp:97 apt=96",
        "a=rtpmap:102 H264/90000",
        "a=rtcp-fb:102 goog-remb",
        "a=rtcp-fb:102 transport-cc",
        "a=rtcp-fb:102 ccm fir",
        "a=rtcp-fb:102 nack",
        "a=rtcp-fb:102 nack pli",
        "a=fmtp:102 level-asymmetry-allowed=1;packetization-mode=1;profile-level-id=42001f",
        "a=rtpmap:103 H264/90000",
        "a=fmtp:103 level-asymmetry-allowed=1;packetization-mode=0;profile-level-id=42e01f",
        "a=rtpmap:106 H264/90000",
        "a=rtcp-fb:106 nack",
        "a=fmtp:106 level-asymmetry-allowed=1;packetization-mode=1;profile-level-id=42e01f",
        "m=application 9 UDP/DTLS/SCTP webrtc-datachannel",
        "c=IN IP4 0.0.0.0",
        "a=ice-ufrag:peer",
        "a=ice-pwd:peerpeerpeerpeerpeerpeer",
        "a=fingerprint:sha-256 " + ":".join(["CD"] * 32),
        "a=setup:actpass",
        "a=mid:2",
        "a=sctp-port:5000",
        "",
    ]
)


def test_a_browsers_offer_is_answered_with_what_both_can():
    offer = read_description(BROWSER, answers=False, ssrcs=SSRCS)
    audio, video = offer.lines
    assert (audio.payload_type, audio.sends, audio.receives, audio.peer_ssrc) == (
        111,
        True,
        True,
        77,
    )
    # Constrained baseline in fragments, though others stand before it.
    assert (video.payload_type, video.sends, video.receives) == (106, True, False)
    line = common_line(video, sends=True, receives=True)
    assert line is not None
    text = write_description([line], LOCAL, session=1, cname="c", stream="s", answers=offer)
    # The sections stay in order; those not wanted are refused by port 0.
    assert [part.split()[0:2] for part in text.split("m=")[1:]] == [
        ["audio", "0"],
        ["video", "9"],
        ["application", "0"],
    ]
    assert "a=group:BUNDLE 1\r\n" in text
    back = read_description(text, answers=True, ssrcs={"audio": 0, "video": 0})
    (theirs,) = back.lines
    assert (theirs.payload_type, theirs.receives, theirs.peer_ssrc) == (106, True, 22)
    assert theirs.extensions == {MID: 4, ABS_SEND_TIME: 2, PLAYOUT_DELAY: 5}
    assert theirs.feedback == {"nack"}


def test_an_answer_does_not_repeat_a_parameter_without_its_value():
    text = re.sub("profile-level-id=[0-9a-f]+", "profile-level-id=", BROWSER)
    offer = read_description(text, answers=False, ssrcs=SSRCS)
    line = common_line(offer.lines[1], sends=True, receives=True)
    answer = write_description([line], LOCAL, session=1, cname="c", stream="s", answers=offer)
    assert "packetization-mode=1" in answer and "profile-level-id" not in answer


def test_our_offer_comes_back_as_it_was():
    lines = [
        wanted_line("audio", mid="0", ssrc=1, sends=True),
        wanted_line("video", mid="1", ssrc=2, sends=True, receives=True),
    ]
    offered = write_description(lines, LOCAL, session=1, cname="c", stream="s")
    audio, video = read_description(offered, answers=False, ssrcs=SSRCS).lines
    assert (audio.sends, audio.receives) == (False, True)
    assert (video.sends, video.receives, video.peer_ssrc) == (True, True, 2)


def test_the_way_stands_in_the_first_section_also_if_that_is_not_wanted():
    found = "a=candidate:1 1 UDP 2015363327 192.0.2.2 40822 typ host"
    text = BROWSER.replace("opus/48000", "speex/16000").replace("a=mid:0", f"a=mid:0\r\n{found}")
    offer = read_description(text, answers=False, ssrcs=SSRCS)
    assert [line.kind for line in offer.lines] == ["video"]
    assert [one.port for one in offer.transport.candidates] == [40822]


@pytest.mark.parametrize(
    ("left_out", "why"),
    [
        ("a=fingerprint", "fingerprint"),
        ("a=ice-pwd", "password"),
        ("a=rtcp-mux", "no bundled"),
        ("a=rtpmap", "not a session"),
        ("a=group", "no bundled"),
    ],
)
def test_what_cannot_be_used_is_refused(left_out, why):
    text = "\r\n".join(line for line in BROWSER.split("\r\n") if not line.startswith(left_out))
    with pytest.raises(ProtocolError, match=why):
        read_description(text, answers=False, ssrcs=SSRCS)


def test_an_endless_description_is_not_read():
    with pytest.raises(ProtocolError, match="octets"):
        read_description("a" * (MOST_SDP_OCTETS + 1), answers=False, ssrcs=SSRCS)


@settings(max_examples=300)
@given(st.data())
def test_garbage_raises_only_protocol_errors(data):
    lines = BROWSER.split("\r\n")
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, len(lines) - 1))
        what = data.draw(st.sampled_from(["cut", "drop", "twice", "text"]))
        if what == "cut":
            lines[at] = lines[at][: data.draw(st.integers(0, len(lines[at])))]
        elif what == "drop" and len(lines) > 1:
            del lines[at]
        elif what == "twice":
            lines.insert(at, lines[at])
        else:
            lines[at] = lines[at][:6] + data.draw(st.text(max_size=8))
    try:
        read_description("\r\n".join(lines), answers=data.draw(st.booleans()), ssrcs=SSRCS)
    except ProtocolError:
        return


def test_candidates_travel_in_fragments():
    offer = read_description(BROWSER, answers=False, ssrcs=SSRCS)
    assert read_candidates(write_candidates(offer.transport, mid="0")).ufrag == "peer"
    fragment = (
        "a=ice-ufrag:u\r\na=ice-pwd:p\r\nm=audio 9 RTP/AVP 0\r\na=mid:0\r\n"
        "a=candidate:1 1 udp 2130706431 192.0.2.1 3456 typ host\r\na=end-of-candidates\r\n"
    )
    told = read_candidates(fragment)
    assert (told.ufrag, told.candidates[0].port, told.complete) == ("u", 3456, True)
    with pytest.raises(ProtocolError, match="user name"):
        read_candidates("a=candidate:1 1 udp 1 192.0.2.1 3 typ host")
    with pytest.raises(ProtocolError, match="candidate"):
        read_candidates("a=ice-ufrag:u\r\na=ice-pwd:p\r\na=candidate:nonsense")


def candidate(address, port, protocol="udp"):
    return f"a=candidate:1 1 {protocol} 2130706431 {address} {port} typ host"


@pytest.mark.parametrize(
    ("address", "port"),
    [
        ("192.0.2.1", 70_000),
        ("192.0.2.1", -1),
        ("192.0.2.1", 0),
        ("192.0.2.1", "9" * 400),
        ("224.0.0.1", 5000),
        ("255.255.255.255", 5000),
        ("0.0.0.0", 5000),
        ("::", 5000),
        ("nobody", 5000),
    ],
)
def test_a_candidate_that_no_datagram_may_go_to_is_left_out(address, port):
    text = "\r\n".join([BROWSER.rstrip("\r\n"), candidate(address, port), ""])
    assert clean_candidates(text) == BROWSER
    assert read_description(text, answers=False, ssrcs=SSRCS).transport.candidates == ()
    fragment = f"a=ice-ufrag:a\r\na=ice-pwd:b\r\n{candidate(address, port)}\r\n"
    assert read_candidates(fragment).candidates == ()


@pytest.mark.parametrize(
    "line",
    [
        *("a=fmtp:96", "a=fmtp:18 annexb=no", "a=fmtp:", "a=rtcp-fb:96", "a=rtcp-fb:*"),
        *("a=ssrc:7", "a=ssrc:7 cname", "a=ssrc:x cname:y", "a=ssrc-group:FID 1 x"),
        *("a=extmap:9 urn:x some more", "a=extmap:x urn:x", "a=extmap-allow-mixed"),
    ],
)
def test_a_line_that_is_malformed_and_not_needed_refuses_nothing(line):
    plain = read_description(BROWSER, answers=False, ssrcs=SSRCS)
    text = BROWSER.replace("a=mid:1\r\n", f"a=mid:1\r\n{line}\r\n")
    assert read_description(text, answers=False, ssrcs=SSRCS) == plain


def test_a_candidate_without_a_foundation_is_taken():
    # As cameras by Google write it.
    line = "a=candidate: 1 udp 2113932031 192.0.2.1 19305 typ host generation 0\r\n"
    text = BROWSER.replace("a=mid:0\r\n", f"a=mid:0\r\n{line}")
    read = read_description(text, answers=False, ssrcs=SSRCS)
    assert [(one.ip, one.port) for one in read.transport.candidates] == [("192.0.2.1", 19305)]


def test_an_answer_need_not_repeat_the_mode_of_h264():
    bare = re.sub("packetization-mode=.;", "", BROWSER.replace("actpass", "active"))
    assert "packetization-mode" not in bare
    kinds = [line.kind for line in read_description(bare, answers=True, ssrcs=SSRCS).lines]
    assert "video" in kinds


def test_loopback_is_for_a_partner_on_this_machine():
    local = [candidate(address, 5000) for address in ("127.0.0.1", "127.9.9.9", "::1")]
    mapped = candidate("::ffff:127.0.0.1", 5000)
    far = [candidate("192.0.2.1", 5000), candidate(f"{'a' * 8}-{'b' * 27}.local", 5000)]
    text = "\n".join([*local, mapped, *far])
    assert clean_candidates(text) == text
    assert clean_candidates(text, loopback=False) == "\n".join(far)


@given(st.text(max_size=200))
@settings(max_examples=300)
def test_any_candidate_is_taken_or_left_out(words):
    cleaned = clean_candidates(f"a=candidate:{words}")
    with contextlib.suppress(ProtocolError):
        read_candidates(f"a=ice-ufrag:a\na=ice-pwd:b\n{cleaned}")


@pytest.mark.parametrize("turned", [False, True])
def test_of_two_pictures_that_is_taken_whose_direction_is_wanted(turned):
    # Some offer one picture to send and one to receive, each in a section of its own.
    lines = [
        wanted_line("video", mid="a", ssrc=1, sends=True),
        wanted_line("video", mid="b", ssrc=2, receives=True),
        wanted_line("video", mid="c", ssrc=3, sends=True, receives=True),
    ]
    text = write_description(
        lines[::-1] if turned else lines, LOCAL, session=1, cname="c", stream="s"
    )
    offered = read_description(text, answers=False, ssrcs=SSRCS).lines
    (taken,) = common_lines(offered, sends={}, receives=("audio", "video"))
    assert (taken.mid, taken.sends, taken.receives) == ("c" if turned else "a", False, True)
    (given,) = common_lines(offered, sends={"video": 1}, receives=())
    assert (given.mid, given.sends, given.receives) == ("c" if turned else "b", True, False)
    assert common_lines(offered, sends={"audio": 1}, receives=("audio",)) == []
