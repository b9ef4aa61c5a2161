"""The sockets of both ends: several receivers in one group, and where reports and feedback go."""

import socket
import struct

import pytest

from kontur_av.clock import NS_PER_MS, NS_PER_S, ManualClock, MonotonicClock
from kontur_av.errors import ConfigError
from kontur_av.media import AccessUnit, CaptureStamp
from kontur_av.rtp.sender import RtpIdentity
from kontur_av.streams.udp import UdpReceiver, UdpSender
from kontur_av.streams.video_receiver import VideoReceiver
from kontur_av.streams.video_sender import VideoSender
from kontur_av.streams.voice_sender import VoiceSender

SENDER_REPORT = struct.pack("!BBHI", 0x80, 200, 6, 7) + bytes(20)


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1]) & ~1


def packet(number: int) -> bytes:
    return struct.pack("!BBHII", 0x80, 0xE0, number, number * 3000, 7) + b"\x41\x88\x01"


def counts(udp: UdpReceiver, receiver: VideoReceiver):
    udp.exchange(receiver, MonotonicClock(), 100 * NS_PER_MS)
    return receiver.counts.rtp


@pytest.mark.parametrize("group", ["224.1.1.9", "ff15::101", "ff02::1234"])
def test_several_receivers_of_a_group_share_its_port(group):
    port = free_port()
    receivers = [UdpReceiver(group, port) for _ in range(2)]
    try:
        with socket.socket(
            socket.AF_INET6 if ":" in group else socket.AF_INET, socket.SOCK_DGRAM
        ) as udp:
            try:
                for number in range(3):
                    udp.sendto(packet(number), (group, port))
            except OSError as error:
                pytest.skip(f"this host sends no multicast: {error}")
        came = [counts(one, VideoReceiver(ssrc=1)).rtp_packets for one in receivers]
        # Whether a packet comes back to its host is the network's affair; it must come to all.
        assert came in ([3, 3], [0, 0])
    finally:
        for one in receivers:
            one.close()


@pytest.mark.parametrize(
    ("sources", "packets"),
    [((), 3), (("127.0.0.2",), 3), (("127.0.0.2", "192.0.2.9", "::1"), 3), (("192.0.2.9",), 0)],
)
def test_a_group_is_heard_on_any_interface_and_from_the_named_sources_only(sources, packets):
    # Loopback is an interface to which no route of groups leads.
    group, port = "239.255.7.9", free_port()
    udp, receiver = UdpReceiver(group, port, sources=sources), VideoReceiver(ssrc=1)
    try:
        for host, garbage in (("127.0.0.1", b"a stranger's"), ("127.0.0.2", b"")):
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
                sender.bind((host, 0))
                sender.setsockopt(
                    socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton("127.0.0.1")
                )
                for number in range(3):
                    sender.sendto(garbage or packet(number), (group, port))
        found = counts(udp, receiver)
        assert (found.rtp_packets, found.garbage) == (packets, 0 if sources else 3)
    finally:
        udp.close()


@pytest.mark.parametrize("one_port", [True, False])
def test_reports_on_the_port_of_the_media_are_taken_and_answered(one_port):
    port = free_port()
    receiver = VideoReceiver(ssrc=1)
    udp = UdpReceiver("127.0.0.1", port, port if one_port else None)
    try:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            sender.settimeout(2)
            for datagram in (packet(0), packet(1), SENDER_REPORT):
                sender.sendto(datagram, ("127.0.0.1", port))
            found = counts(udp, receiver)
            assert (found.rtp_packets, found.rtcp_reports, found.garbage) == (2, 1, 0)
            assert udp.reported
            udp.exchange(receiver, MonotonicClock())
            answer, source = sender.recvfrom(1500)
        assert answer[1] == 201 and source == ("127.0.0.1", port)
    finally:
        udp.close()


def bound(host="127.0.0.1", port=0):
    udp = socket.socket(socket.AF_INET6 if ":" in host else socket.AF_INET, socket.SOCK_DGRAM)
    udp.settimeout(5)
    udp.bind((host, port))
    return udp


def sender_of_one_picture():
    sender = VideoSender(
        cap_bps=1_000_000, fps=30, cname="x", identity=RtpIdentity(5, 0, 0), adapt_refresh=False
    )
    unit = AccessUnit(b"\0\0\1\x65\x88" + bytes([7]) * 2000, CaptureStamp(0, 0, "x"), True)
    sender.handle_coded(unit, 0)
    return sender


@pytest.mark.parametrize("host", ["127.0.0.1", "::1"])
def test_media_goes_to_one_port_and_reports_to_the_next(host):
    clock, sender = ManualClock(), sender_of_one_picture()
    port = free_port()
    with bound(host, port) as rtp, bound(host, port + 1) as rtcp:
        udp = UdpSender(host, port)
        try:
            udp.exchange(sender, clock)
            assert rtp.recv(2000)[1] & 0x7F == 96
            report, source = rtcp.recvfrom(2000)
            assert report[1] == 200
            clock.advance_ns(300 * NS_PER_MS)
            # Feedback comes back to where reports come from; garbage is counted.
            indication = bytes.fromhex("81ce0002 00000001 00000005")
            for datagram in (indication, b"?", indication):
                rtcp.sendto(datagram, source)
            udp.exchange(sender, clock)
            assert (sender.feedback.feedback_received, sender.feedback.feedback_garbage) == (2, 1)
            assert rtp.recv(2000)[1] & 0x80, "the last packet of the picture"
            udp.say_goodbye(sender, clock)
            assert rtcp.recv(2000)[-8:] == bytes.fromhex("81cb0001 00000005")
            assert udp.failed == 0
        finally:
            udp.close()


def test_a_stream_that_never_began_says_no_goodbye_and_a_voice_takes_no_feedback():
    voice = VoiceSender(cap_bps=16_000, cname="x", identity=RtpIdentity(5, 0, 0))
    port, clock = free_port(), ManualClock()
    with bound(port=port) as rtp, bound(port=port + 1) as rtcp:
        udp = UdpSender("127.0.0.1", port)
        try:
            udp.say_goodbye(voice, clock)
            voice.handle_packet(b"\x08\x80" * 9, CaptureStamp(0, 0, "x"), 0)
            udp.exchange(voice, clock)
            assert rtp.recv(2000)[1] == 0x80 | 97
            report, source = rtcp.recvfrom(2000)
            assert report[1] == 200, "no goodbye before it"
            rtcp.sendto(b"?", source)
            udp.exchange(voice, clock)
        finally:
            udp.close()


def test_what_the_system_refuses_is_a_loss():
    udp, sender = UdpSender("255.255.255.255", 5004), sender_of_one_picture()
    try:
        # It takes no broadcast from such a socket.
        udp.exchange(sender, ManualClock())
        assert udp.failed == 2
    finally:
        udp.close()


def test_a_port_that_is_taken_is_refused_and_nothing_stays_open():
    port = free_port()
    with bound(port=port + 1):
        with pytest.raises(ConfigError, match=f"UDP port {port + 1} cannot be opened"):
            UdpReceiver("127.0.0.1", port)
        # The first port is free again.
        bound(port=port).close()
        with pytest.raises(ConfigError, match=f"UDP port {port + 1}"):
            UdpReceiver("127.0.0.1", port + 1, port)
        UdpReceiver("127.0.0.1", port, port).close()


@pytest.mark.parametrize(
    ("host", "heard"), [("127.0.0.1", False), ("192.0.2.7", True), ("0.0.0.0", True)]
)
def test_an_address_of_another_machine_binds_all(host, heard):
    port = free_port()
    udp, receiver = UdpReceiver(host, port), VideoReceiver(ssrc=1)
    try:
        assert len(udp.sockets) == 2 and not udp.reported
        with bound() as sender:
            for number in range(2):
                sender.sendto(packet(number), ("127.0.0.2", port))
        udp.exchange(receiver, MonotonicClock())
        assert receiver.counts.rtp.rtp_packets == (2 if heard else 0)
    finally:
        udp.close()


def test_feedback_goes_to_the_sender_of_reports_alone():
    port, receiver = free_port(), VideoReceiver(ssrc=1)
    udp = UdpReceiver("127.0.0.1", port)
    try:
        with bound() as sender, bound() as stranger:
            for number in range(2):
                sender.sendto(packet(number), ("127.0.0.1", port))
            sender.sendto(SENDER_REPORT, ("127.0.0.1", port + 1))
            udp.exchange(receiver, MonotonicClock(), NS_PER_S)
            stranger.sendto(b"\x80\xc9\0\1\0\0\0\7", ("127.0.0.1", port + 1))
            udp.exchange(receiver, MonotonicClock())
            udp.exchange(receiver, MonotonicClock())
            answer, source = sender.recvfrom(2000)
            assert answer[1] == 201 and source[1] == port + 1
            stranger.settimeout(0.01)
            with pytest.raises(TimeoutError):
                stranger.recv(2000)
    finally:
        udp.close()
