"""A restarted receiving process continues with what its predecessor has kept."""

import socket
from contextlib import ExitStack
from types import SimpleNamespace

from rtp_packets import make_sender

from kontur_av.clock import ManualClock
from kontur_av.media import AccessUnit, CaptureStamp
from kontur_av.rtp.receiver import RtpReceiver
from pipelines.media import process_receive
from pipelines.media.process_receive import Incoming
from pipelines.session.setup.setup_file import BUILT_IN
from pipelines.table import topology_of


def test_a_restarted_receiver_knows_the_last_sender_report(tmp_path, monkeypatch):
    monkeypatch.setattr(process_receive, "session_root", lambda session: tmp_path)
    sender = make_sender(timestamp_offset=0)
    unit = AccessUnit(b"\x00\x00\x01\x41\x88\x01", CaptureStamp(10**9, 0, "test"), False)
    packets = sender.video_packets(unit).packets + sender.video_packets(unit).packets
    report = sender.poll_report(10**9)
    with ExitStack() as opened:
        gateway = []

        def listen(port):
            far, near = map(
                opened.enter_context, socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
            )
            near.setblocking(False)
            gateway.append(far)
            return near

        context = SimpleNamespace(
            session="x",
            topology=topology_of(BUILT_IN["taskboard"]),
            clock=ManualClock(),
            listen_media=listen,
        )

        def restarted():
            receiver = RtpReceiver(payload_type=96, clock_rate_hz=90_000)
            incoming = Incoming(context, BUILT_IN["taskboard"].uplink_video, receiver)
            for packet in packets:
                receiver.handle_packet(packet, 0)
            return receiver, incoming

        before, incoming = restarted()
        for datagram in (report, report[28:], b"\x80\xcc\x00\x01abcd", b"garbage"):
            gateway[1].send(datagram)
        incoming.wait(10**9)
        assert before.counts.rtcp_reports + before.counts.garbage == 4
        after, _ = restarted()
        assert after.capture_ns(90_000) == before.capture_ns(90_000) == 10**9
