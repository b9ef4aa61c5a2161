"""The sockets of a stream's ends: RTP on one UDP port, RTCP on the next (RFC 3550 section 11)."""

import socket
from contextlib import suppress

from kontur_av.clock import Clock
from kontur_av.streams.video_sender import VideoSender
from kontur_av.streams.voice_sender import VoiceSender

_FEEDBACK_OCTETS = 1500


class UdpSender:
    """Sends to an IP address, and takes the receiver's feedback. `close` it at the end.

    host: an IP address. port: of RTP. RTCP goes to the next port; feedback comes back to where
    reports came from.
    """

    def __init__(self, host: str, port: int) -> None:
        self._udp = socket.socket(
            socket.AF_INET6 if ":" in host else socket.AF_INET, socket.SOCK_DGRAM
        )
        self._to_rtp, self._to_rtcp = (host, port), (host, port + 1)
        #: Datagrams that the system did not take.
        self.failed = 0

    def exchange(self, sender: VideoSender | VoiceSender, clock: Clock) -> None:
        """Pass feedback to `sender`, and send what may leave by now."""
        # The answer of the system to an earlier datagram is no feedback.
        with suppress(BlockingIOError, ConnectionError):
            while True:
                datagram = self._udp.recv(_FEEDBACK_OCTETS, socket.MSG_DONTWAIT)
                if isinstance(sender, VideoSender):
                    sender.handle_feedback(datagram, clock.now_ns())
        while (packet := sender.poll_transmit(clock.now_ns())) is not None:
            self._send(packet, self._to_rtp)
        report = sender.poll_report(clock.now_ns())
        if report is not None:
            self._send(report, self._to_rtcp)

    def say_goodbye(self, sender: VideoSender | VoiceSender) -> None:
        """Tell the receiver that the stream has ended."""
        goodbye = sender.goodbye()
        if goodbye is not None:
            self._send(goodbye, self._to_rtcp)

    def close(self) -> None:
        """Close the socket."""
        self._udp.close()

    def _send(self, datagram: bytes, to: tuple[str, int]) -> None:
        try:
            self._udp.sendto(datagram, to)
        except OSError:
            # A network that goes down and comes back is loss to the receiver, no end to the sender.
            self.failed += 1
