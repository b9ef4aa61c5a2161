"""aiortc's RTP packets load without its ICE, DTLS and SCTP, and aiortc stays usable for others."""

import subprocess
import sys

_PROGRAM = """
import sys
from kontur_av.rtp.wire import RtpPacket, parse_rtp
assert not {"aioice", "cryptography", "aiortc"} & set(sys.modules), "more than packets is loaded"
packet = RtpPacket(payload_type=96, sequence_number=7, timestamp=9, ssrc=5, payload=b"abc")
assert parse_rtp(packet.serialize()).payload == b"abc"

import aiortc.rtp
assert aiortc.RTCPeerConnection and aiortc.rtp.RtpPacket.parse(packet.serialize()).ssrc == 5
"""


def test_only_the_packets_of_aiortc_are_loaded() -> None:
    subprocess.run([sys.executable, "-c", _PROGRAM], check=True, timeout=60)
