"""What every sending process does alike: RTP and its reports to the gateway."""

import secrets

from kontur_av.rtp.payload_h264 import DEFAULT_MAX_PAYLOAD_OCTETS
from kontur_av.rtp.sender import RTP_HEADER_OCTETS, RtpSender
from pipelines.names import REPORT_INTERVAL_NS, cname
from pipelines.process import Context
from pipelines.setup import VideoStream, VoiceStream


class Outgoing:
    """A stream's way to the gateway; `rtp` makes its packets."""

    def __init__(
        self,
        context: Context,
        stream: VideoStream | VoiceStream,
        *,
        payload_type: int,
        clock_rate_hz: int,
        max_payload_octets: int = DEFAULT_MAX_PAYLOAD_OCTETS,
    ) -> None:
        # Random, as RFC 3550 section 5.1 asks: a restarted sender is a new source.
        self.rtp = RtpSender(
            payload_type=payload_type,
            clock_rate_hz=clock_rate_hz,
            ssrc=secrets.randbits(32),
            first_sequence=secrets.randbits(16),
            timestamp_offset=secrets.randbits(32),
            cname=cname(stream.name),
            report_interval_ns=REPORT_INTERVAL_NS,
            max_payload_octets=max_payload_octets,
        )
        ports = context.setup.ports
        self._clock = context.clock
        self._sent = context.probe.rows("out")
        self._to_gateway = context.sender(ports.entry(stream.name))
        self._to_gateway_rtcp = context.sender(ports.entry(f"{stream.name}_rtcp"))

    def send(self, packet: bytes, now_ns: int) -> None:
        """Send a packet of `rtp`, and have its payload metered."""
        self._to_gateway(packet)
        self._sent.extend((now_ns, len(packet) - RTP_HEADER_OCTETS))

    def send_report(self, now_ns: int) -> None:
        """Send a report if one is due."""
        report = self.rtp.poll_report(now_ns, self._clock.ntp)
        if report is not None:
            self._to_gateway_rtcp(report)

    def close(self) -> None:
        """Say goodbye, so that a successor is believed at once."""
        goodbye = self.rtp.goodbye(self._clock.ntp)
        if goodbye is not None:
            self._to_gateway_rtcp(goodbye)
