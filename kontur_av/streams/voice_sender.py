"""The sender of a voice stream: which blocks of sound to encode, and which packets may leave."""

from kontur_av.clock import NS_PER_S
from kontur_av.codecs.opus import bitrate_under_cap, heard_stamp
from kontur_av.media import AUDIO_CLOCK_HZ, AUDIO_PAYLOAD_TYPE, BLOCK_NS, CaptureStamp
from kontur_av.rtp.sdp import session_bandwidth_bps
from kontur_av.rtp.sender import RtpIdentity, RtpSender
from kontur_av.streams.budget import Pacer
from kontur_av.streams.paced_sender import PacedSender, SenderCounts, UnitSent

#: An older block is not sent, because it would delay those after it.
_TOO_OLD_NS = 5 * BLOCK_NS


class VoiceSender(PacedSender):
    """Sends a voice as Opus over RTP, at a constant rate under a hard cap. A core.

    Call `handle_block` for each block of sound. If it returns True, encode the block and pass the
    Opus packet to `handle_packet`. Then, and at `poll_timeout`, send the packets of `poll_transmit`
    to the RTP port until None, and the report of `poll_report` to the RTCP port. `next_event` is
    for figures; the oldest events are dropped if the caller takes none.

    Arguments: as of `VideoSender`. Raises ConfigError for a cap or channel that cannot work.
    """

    def __init__(
        self,
        *,
        cap_bps: int,
        identity: RtpIdentity,
        cname: str,
        channel_bps: int | None = None,
        wall_offset_ns: int = 0,
        payload_type: int = AUDIO_PAYLOAD_TYPE,
        report_interval_ns: int = NS_PER_S,
        capture_time_id: int | None = None,
    ) -> None:
        #: The rate for which to make the `OpusEncoder`.
        self.bitrate_bps = bitrate_under_cap(cap_bps)
        # The rate is constant, but a process that was held up has two packets at once.
        pacer = Pacer(cap_bps=cap_bps, channel_bps=channel_bps)
        rtp = RtpSender(
            payload_type=payload_type,
            clock_rate_hz=AUDIO_CLOCK_HZ,
            ssrc=identity.ssrc,
            first_sequence=identity.first_sequence,
            timestamp_offset=identity.timestamp_offset,
            cname=cname,
            report_interval_ns=report_interval_ns,
            bandwidth_bps=session_bandwidth_bps(cap_bps, NS_PER_S / BLOCK_NS),
            wall_offset_ns=wall_offset_ns,
            capture_time_id=capture_time_id,
        )
        super().__init__(pacer, rtp)
        self._captured = self._refused = 0

    def handle_block(self, stamp: CaptureStamp, now_ns: int) -> bool:
        """Handle a new block of sound. Return whether to encode it."""
        self._captured += 1
        oldest_ns = max(now_ns - stamp.capture_ns, self.oldest_age_ns(now_ns))
        if oldest_ns > _TOO_OLD_NS:
            self._refused += 1
            return False
        return True

    def handle_packet(self, opus: bytes, stamp: CaptureStamp, encoded_ns: int) -> None:
        """The block of `stamp` is encoded as `opus`, since `encoded_ns`."""
        heard = heard_stamp(stamp)
        self._queue(self._rtp.audio_packets(opus, heard), heard.capture_ns, encoded_ns)

    def poll_timeout(self) -> int | None:
        """Return when to call `poll_transmit` next; None while nothing waits."""
        return self._pacer.poll_timeout()

    def next_event(self) -> UnitSent | None:
        """Return the next block whose packet has left, or None."""
        return self._events.popleft() if self._events else None

    @property
    def counts(self) -> SenderCounts:
        """The blocks so far."""
        return self._counts(captured=self._captured, refused=self._refused)
