"""The common part of video and voice receivers: the packets of a stream, and reports on them."""

from typing import Any

from kontur_av.modular import serial_difference
from kontur_av.rtp.feedback import ReceptionReporter
from kontur_av.rtp.receiver import RtpReceiver
from kontur_av.rtp.rtcp import RtcpReceiverInfo

#: The timestamps from its first one on that are taken for those of a new source.
_BEGINNING = 1 << 28


class ReportingReceiver:
    """Base of the receivers: it puts packets in order, and reports on them."""

    def __init__(self, receiver: RtpReceiver, reports: ReceptionReporter) -> None:
        self._receiver = receiver
        self._reports = reports

    @property
    def ended(self) -> bool:
        """Whether the sender has said goodbye."""
        return self._receiver.ended

    def take_restart(self, timestamp: int) -> bool:
        """Return, once, whether this picture or sound is the first of a sender that began anew."""
        at = self._receiver.restarted_at
        if at is None or not 0 <= serial_difference(timestamp - at) < _BEGINNING:
            return False
        self._receiver.restarted_at = None
        return True

    @property
    def other_payload_type(self) -> int | None:
        """The newest payload type that came instead of the stream's; None: there was none."""
        return self._receiver.other_payload_type

    def handle_packet(self, datagram: bytes, now_ns: int, source: Any = None) -> None:
        """Handle a datagram of the RTP port. Garbage is counted. Drain `next_event` afterwards.

        source: see `RtpReceiver.handle_packet`.
        """
        self._receiver.handle_packet(datagram, now_ns, source)

    def handle_report(self, datagram: bytes, now_ns: int) -> bool:
        """Handle a datagram of the RTCP port. True if it was a sender report of the stream.

        Garbage is counted. Drain `next_event` afterwards.
        """
        dates = self._receiver.handle_report(datagram, now_ns)
        if dates:
            self._reports.handle_sender_report(now_ns)
        return dates

    def report_block(self, now_ns: int) -> RtcpReceiverInfo | None:
        """Return the block of a receiver report, for a caller that sends reports itself.

        None: no packet came since the last one.
        """
        return self._receiver.report_block(now_ns)

    def capture_ns(self, timestamp: int) -> int | None:
        """Return when the picture or sound of this RTP timestamp was captured, in ns.

        None before the first sender report.
        """
        return self._receiver.capture_ns(timestamp)
