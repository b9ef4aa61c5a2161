"""The sample's own command, received on a real socket and shown."""

import socket
import subprocess
import sys
import time

from places import ROOT

from kontur_av.codecs.h264 import H264Decoder
from kontur_av.media import VIDEO_CLOCK_HZ, planes
from kontur_av.rtp.payload_h264 import H264Depacketizer
from kontur_av.rtp.receiver import RtpReceiver
from kontur_av.rtp.sdp import parse_sdp

SAMPLE = ROOT / "samples" / "send_numpy.py"


def test_send_numpy(tmp_path):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as udp:
        udp.bind(("127.0.0.1", 0))
        udp.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 20)
        port = udp.getsockname()[1]
        sdp = tmp_path / "picture.sdp"
        command = [sys.executable, SAMPLE, "127.0.0.1", str(port), "85", sdp, "2"]
        done = subprocess.run(command, capture_output=True, text=True, timeout=60)
        assert done.returncode == 0, done.stderr
        stream = parse_sdp(sdp.read_text())
        assert (stream.kind, stream.port) == ("video", port)
        receiver = RtpReceiver(payload_type=stream.payload_type, clock_rate_hz=VIDEO_CLOCK_HZ)
        depacketizer, decoder = H264Depacketizer(), H264Decoder()
        udp.settimeout(0.2)
        pictures = []
        while True:
            try:
                receiver.handle_packet(udp.recv(2048), time.monotonic_ns())
            except TimeoutError:
                break
            while (packet := receiver.next_event()) is not None:
                depacketizer.handle_packet(packet)
            while (unit := depacketizer.next_event()) is not None:
                pictures += decoder.decode(unit.data, unit.timestamp)
    # Two seconds on a machine of any speed: no rate is asserted but the cap.
    assert len(pictures) >= 10
    assert receiver.counts.lost == receiver.counts.garbage == decoder.corrupt_units == 0
    assert 0 < receiver.counts.payload_octets * 8 <= 2 * 85_000 * 1.1
    luma = planes(pictures[-1].to_i420())[0]
    assert luma.max() > 120
    assert "largest second" in done.stdout
