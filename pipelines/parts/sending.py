"""What every sending process does alike: RTP and its reports to the gateway."""

import secrets

from pipelines.cores.sending import RtpIdentity, VideoSending, VoiceSending
from pipelines.runtime.process import Context
from pipelines.setup.table import VideoStream, VoiceStream


class Outgoing:
    """A stream's way to the gateway."""

    def __init__(
        self,
        context: Context,
        stream: VideoStream | VoiceStream,
        sending: VideoSending | VoiceSending,
    ) -> None:
        ports = context.setup.ports
        self._clock = context.clock
        self._sending = sending
        self._to_gateway = context.sender(ports.entry(stream.name))
        self._to_gateway_rtcp = context.sender(ports.entry(f"{stream.name}_rtcp"))

    def send_due(self) -> None:
        """Send what may leave now, and a report if one is due."""
        now_ns = self._clock.now_ns()
        while (packet := self._sending.poll_transmit(now_ns)) is not None:
            self._to_gateway(packet)
        report = self._sending.poll_report(now_ns, self._clock.ntp)
        if report is not None:
            self._to_gateway_rtcp(report)

    def close(self) -> None:
        """Say goodbye, so that a successor is believed at once."""
        goodbye = self._sending.goodbye(self._clock.ntp)
        if goodbye is not None:
            self._to_gateway_rtcp(goodbye)


def random_identity() -> RtpIdentity:
    """What a new sender is known by."""
    return RtpIdentity.draw(secrets.randbits)
