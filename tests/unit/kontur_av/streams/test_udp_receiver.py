"""The sockets of a receiver: several in one multicast group, and reports on the port of RTP."""

import socket
import struct

import pytest

from kontur_av.clock import NS_PER_MS, MonotonicClock
from kontur_av.streams.udp import UdpReceiver
from kontur_av.streams.video_receiver import VideoReceiver

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
