"""A restarted receiving process continues with what its predecessor has kept."""

import socket
from types import SimpleNamespace

import pytest
from rtp_packets import PromptSender

from kontur_av.clock import ManualClock
from kontur_av.media import AccessUnit, CaptureStamp
from kontur_av.rtp.receiver import RtpReceiver
from pipelines.media import process_receive
from pipelines.media.process_receive import Incoming
from pipelines.session.setup.setup_file import BUILT_IN
from pipelines.table import topology_of


@pytest.fixture
def context(tmp_path, monkeypatch):
    monkeypatch.setattr(process_receive, "session_root", lambda session: tmp_path)
    sockets = []

    def listen(port):
        udp = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        udp.bind(("127.0.0.1", 0))
        udp.setblocking(False)
        sockets.append(udp)
        return udp

    def receive(udp):
        try:
            return udp.recv(2048)
        except BlockingIOError:
            return None

    yield SimpleNamespace(
        session="x",
        setup=BUILT_IN["taskboard"],
        topology=topology_of(BUILT_IN["taskboard"]),
        clock=ManualClock(),
        listen_media=listen,
        receive=receive,
        sockets=sockets,
    )
    for udp in sockets:
        udp.close()


def test_a_restarted_receiver_knows_the_last_sender_report(context):
    def receiver():
        return RtpReceiver(payload_type=96, clock_rate_hz=90_000)

    sender = PromptSender(
        payload_type=96,
        clock_rate_hz=90_000,
        ssrc=1,
        first_sequence=0,
        timestamp_offset=0,
        cname="gnd",
    )
    unit = AccessUnit(b"\x00\x00\x01\x41\x88\x01", CaptureStamp(10**9, 0, "test"), False)
    first, second = sender.video_packets(unit).packets + sender.video_packets(unit).packets
    report = sender.poll_report(10**9)
    before = receiver()
    for packet in (first, second):
        before.handle_packet(packet, 0)
    incoming = Incoming(context, context.setup.uplink_video, before)
    rtcp = context.sockets[1].getsockname()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as gateway:
        for datagram in (report, report[28:], b"\x80\xcc\x00\x01abcd", b"garbage"):
            gateway.sendto(datagram, rtcp)
        while before.counts.rtcp_reports + before.counts.garbage < 4:
            incoming.wait(10**9)
    after = receiver()
    Incoming(context, context.setup.uplink_video, after)
    for packet in (first, second):
        after.handle_packet(packet, 0)
    assert after.capture_ns(90_000) == before.capture_ns(90_000) == 10**9
