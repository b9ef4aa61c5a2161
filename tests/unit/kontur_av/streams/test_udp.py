"""The sockets of both ends: several receivers in one group, and where reports and feedback go."""

import socket
import struct
from contextlib import closing

import pytest
from common import free_port
from picture_stream import coded

from kontur_av.clock import NS_PER_MS, ManualClock, MonotonicClock
from kontur_av.errors import ConfigError
from kontur_av.media import CaptureStamp
from kontur_av.rtp.sender import RtpIdentity
from kontur_av.streams.udp import UdpReceiver, UdpSender
from kontur_av.streams.video_receiver import VideoReceiver
from kontur_av.streams.video_sender import VideoSender
from kontur_av.streams.voice_sender import VoiceSender

HOST = "127.0.0.1"
SENDER_REPORT = struct.pack("!BBHI", 0x80, 200, 6, 7) + bytes(20)


def two_ports() -> int:
    """Return a free port whose successor is free, too."""
    port = free_port(more=2)
    return port + (port & 1)


def packet(number: int) -> bytes:
    return struct.pack("!BBHII", 0x80, 0xE0, number, number * 3000, 7) + b"\x41\x88\x01"


def bound(host=HOST, port=0):
    udp = socket.socket(socket.AF_INET6 if ":" in host else socket.AF_INET, socket.SOCK_DGRAM)
    udp.settimeout(5)
    udp.bind((host, port))
    return udp


class Receiving:
    """A receiver at its sockets."""

    def __init__(self, host, port, *more, **options):
        self.udp, self.receiver = UdpReceiver(host, port, *more, **options), VideoReceiver(ssrc=1)
        self.close = self.udp.close

    def counts(self):
        """Return the counts after what has arrived."""
        self.udp.exchange(self.receiver, MonotonicClock(), 100 * NS_PER_MS)
        return self.receiver.counts.rtp


def test_a_goodbye_that_waits_with_the_last_packets_ends_the_stream():
    port = two_ports()
    with closing(Receiving(HOST, port)) as end, bound() as udp:
        for number in range(3):
            udp.sendto(packet(number), (HOST, port))
        udp.sendto(SENDER_REPORT + struct.pack("!BBHI", 0x81, 203, 1, 7), (HOST, port + 1))
        assert end.counts().rtp_packets == 3 and end.receiver.ended


@pytest.mark.parametrize("group", ["224.1.1.9", "ff15::101", "ff02::1234"])
def test_several_receivers_of_a_group_share_its_port(group):
    port = two_ports()
    with closing(Receiving(group, port)) as one, closing(Receiving(group, port)) as other:
        with bound("::" if ":" in group else "0.0.0.0") as udp:
            try:
                for number in range(3):
                    udp.sendto(packet(number), (group, port))
            except OSError as error:
                pytest.skip(f"this host sends no multicast: {error}")
        # Whether a packet comes back to its host is the network's affair; it must come to all.
        came = [end.counts().rtp_packets for end in (one, other)]
        assert came in ([3, 3], [0, 0])


@pytest.mark.parametrize(
    ("sources", "packets"),
    [((), 3), (("127.0.0.2",), 3), (("127.0.0.2", "192.0.2.9", "::1"), 3), (("192.0.2.9",), 0)],
)
def test_a_group_is_heard_on_any_interface_and_from_the_named_sources_only(sources, packets):
    # Loopback is an interface to which no route of groups leads.
    group, port, loopback = "239.255.7.9", two_ports(), socket.inet_aton(HOST)
    with closing(Receiving(group, port, sources=sources)) as end:
        for host, garbage in ((HOST, b"a unknown sender's"), ("127.0.0.2", b"")):
            with bound(host) as sender:
                sender.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, loopback)
                for number in range(3):
                    sender.sendto(garbage or packet(number), (group, port))
        found = end.counts()
        assert (found.rtp_packets, found.garbage) == (packets, 0 if sources else 3)


@pytest.mark.parametrize("ports", ["one", "two", "two, reports on the first"])
def test_reports_are_taken_and_answered_where_they_come_from(ports):
    port = two_ports()
    control = port if ports != "two" else port + 1
    with closing(Receiving(HOST, port, *[port] * (ports == "one"))) as end, bound() as sender:
        for datagram, to in ((packet(0), port), (packet(1), port), (SENDER_REPORT, control)):
            sender.sendto(datagram, (HOST, to))
        found = end.counts()
        assert (found.rtp_packets, found.rtcp_reports, found.garbage) == (2, 1, 0)
        assert end.udp.reported
        # Feedback goes to the sender of reports alone.
        with bound() as unknown:
            unknown.sendto(b"\x80\xc9\0\1\0\0\0\7", (HOST, control))
            end.counts()
            end.udp.exchange(end.receiver, MonotonicClock())
            answer, source = sender.recvfrom(2000)
            assert answer[1] == 201 and source == (HOST, control)
            unknown.setblocking(False)
            with pytest.raises(BlockingIOError):
                unknown.recv(2000)


def sender_of_one_picture():
    sender = VideoSender(
        cap_bps=1_000_000, fps=30, cname="x", identity=RtpIdentity(5, 0, 0), adapt_refresh=False
    )
    sender.handle_coded(coded(0, 2000, key=True), 0)
    return sender


@pytest.mark.parametrize("host", [HOST, "::1"])
def test_media_goes_to_one_port_and_reports_to_the_next(host):
    clock, sender, port = ManualClock(), sender_of_one_picture(), two_ports()
    with (
        bound(host, port) as rtp,
        bound(host, port + 1) as rtcp,
        closing(UdpSender(host, port)) as udp,
    ):
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


def test_a_stream_that_never_began_says_no_goodbye_and_a_voice_takes_no_feedback():
    voice = VoiceSender(cap_bps=16_000, cname="x", identity=RtpIdentity(5, 0, 0))
    port, clock = two_ports(), ManualClock()
    with bound(port=port + 1) as rtcp, closing(UdpSender(HOST, port)) as udp:
        udp.say_goodbye(voice, clock)
        voice.handle_packet(b"\x08\x80" * 9, CaptureStamp(0, 0, "x"), 0)
        udp.exchange(voice, clock)
        report, source = rtcp.recvfrom(2000)
        assert report[1] == 200, "no goodbye before it"
        rtcp.sendto(b"?", source)
        udp.exchange(voice, clock)


def test_what_the_system_refuses_is_a_loss():
    with closing(UdpSender("255.255.255.255", 5004)) as udp:
        # It takes no broadcast from such a socket.
        udp.exchange(sender_of_one_picture(), ManualClock())
        assert udp.failed == 2


def test_a_port_that_is_taken_is_refused_and_nothing_stays_open():
    port = two_ports()
    with bound(port=port + 1):
        for ports in ((port,), (port + 1, port)):
            with pytest.raises(ConfigError, match=f"UDP port {port + 1} cannot be opened"):
                UdpReceiver(HOST, *ports)
            # The first port is free again.
            bound(port=port).close()
        UdpReceiver(HOST, port, port).close()


@pytest.mark.parametrize(("host", "heard"), [(HOST, 0), ("192.0.2.7", 2), ("0.0.0.0", 2)])
def test_an_address_of_another_machine_binds_all(host, heard):
    port = two_ports()
    with closing(Receiving(host, port)) as end, bound() as sender:
        assert len(end.udp.sockets) == 2 and not end.udp.reported
        for number in range(2):
            sender.sendto(packet(number), ("127.0.0.2", port))
        end.udp.exchange(end.receiver, MonotonicClock())
        assert end.receiver.counts.rtp.rtp_packets == heard
