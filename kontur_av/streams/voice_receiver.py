"""A voice, from the loudspeaker's side: blocks of sound, each at the instant to hear it."""

from collections import deque
from dataclasses import dataclass
from typing import NamedTuple

from kontur_av.clock import NS_PER_S
from kontur_av.media import AUDIO_CLOCK_HZ, AUDIO_PAYLOAD_TYPE, CaptureStamp, Quality
from kontur_av.rtp.playout import PlayoutBlock, PlayoutBuffer
from kontur_av.rtp.playout_block import PlayoutCounts
from kontur_av.rtp.receiver import ReceiverCounts, RtpReceiver
from kontur_av.streams.lipsync import LipSync

#: Arrivals that are kept for a caller that takes none; the oldest goes.
_ARRIVALS_KEPT = 256


class PacketReceived(NamedTuple):
    """A packet of a voice has come. timestamp: its RTP timestamp."""

    timestamp: int
    received_ns: int


@dataclass(frozen=True, slots=True, kw_only=True)
class VoiceReceiverCounts:
    """rtp: packets. jitter_ns: of their arrival (RFC 3550 appendix A.8). playout: blocks. corrupt:
    blocks that were no Opus. undated: blocks of which no sender report says how old they are.
    inserted_ns: filled in where the delay grew. delay_ns: of the playout now."""

    rtp: ReceiverCounts
    jitter_ns: int
    playout: PlayoutCounts
    corrupt: int
    undated: int
    inserted_ns: int
    delay_ns: int


class VoiceReceiver:
    """Receives a voice as Opus over RTP. A core: it is told the time.

    1. Pass datagrams to `handle_packet` and `handle_report`, and call `handle_timeout` at
       `poll_timeout`.
    2. Play each block of `next_event` at once, with a `VoicePlayer`: its time has come.
    3. Ask `handle_sound` for its stamp.

    For lip-sync also tell it when pictures of the same place are shown (`handle_picture_shown`).

    name: stands as the source in the stamps.
    wall_offset_ns: an instant plus this is the Unix time, which sender reports tell.
    oldest_picture_ns: older pictures delay no sound. oldest_sound_ns: lip-sync makes no sound
        older. 0: no sound waits for its picture.
    """

    def __init__(
        self,
        *,
        name: str = "voice",
        wall_offset_ns: int = 0,
        oldest_picture_ns: int = 0,
        oldest_sound_ns: int = 0,
        payload_type: int = AUDIO_PAYLOAD_TYPE,
    ) -> None:
        self._receiver = RtpReceiver(
            payload_type=payload_type,
            clock_rate_hz=AUDIO_CLOCK_HZ,
            ordered=False,
            wall_offset_ns=wall_offset_ns,
        )
        self._name = name
        self._playout = PlayoutBuffer()
        self._lip_sync = LipSync(
            oldest_picture_ns=oldest_picture_ns, oldest_sound_ns=oldest_sound_ns
        )
        self._arrivals: deque[PacketReceived] = deque(maxlen=_ARRIVALS_KEPT)
        self._heard = self._corrupt = self._undated = self._inserted_ns = 0

    @property
    def ended(self) -> bool:
        """Whether the sender has said goodbye."""
        return self._receiver.ended

    def handle_packet(self, datagram: bytes, now_ns: int) -> None:
        """A datagram of the RTP port. Garbage is counted. Drain `next_event` afterwards."""
        self._receiver.handle_packet(datagram, now_ns)
        self._take_packets(now_ns)

    def handle_report(self, datagram: bytes, now_ns: int) -> bool:
        """A datagram of the RTCP port; True if it says how old sounds are.

        Garbage is counted. Drain `next_event` afterwards.
        """
        dates = self._receiver.handle_report(datagram, now_ns)
        self._take_packets(now_ns)
        return dates

    def handle_picture_shown(self, shown_ns: int, latency_ns: int) -> None:
        """A picture of the same place was shown, so much after its capture."""
        self._lip_sync.handle_picture(shown_ns, latency_ns)

    def handle_timeout(self, now_ns: int) -> None:
        """Play what is due by now. Drain `next_event` afterwards."""
        self._playout.handle_timeout(now_ns)

    def poll_timeout(self) -> int | None:
        """When the next block is due."""
        return self._playout.poll_timeout()

    def next_event(self) -> PlayoutBlock | None:
        """The next block that is due: with an Opus packet, or to be made up."""
        return self._playout.next_event()

    def take_arrivals(self) -> list[PacketReceived]:
        """The packets that have come since the last call, for figures."""
        arrivals = list(self._arrivals)
        self._arrivals.clear()
        return arrivals

    def capture_ns(self, timestamp: int) -> int | None:
        """When the sound of this RTP timestamp was captured; None before a sender report."""
        return self._receiver.capture_ns(timestamp)

    def handle_sound(
        self, block: PlayoutBlock, *, decoded: bool, capture_ns: int | None
    ) -> CaptureStamp | None:
        """A block sounds: decoded, or made up because it was lost or no Opus. Its stamp.

        capture_ns: as `capture_ns` says of the block's timestamp. None if nothing says how old it
        is.
        """
        if not decoded and block.payload is not None:
            self._corrupt += 1
        if block.inserted:
            self._inserted_ns += block.played_samples * NS_PER_S // AUDIO_CLOCK_HZ
        if capture_ns is None:
            self._undated += 1
            return None
        quality = Quality.FRESH if decoded else Quality.CONCEALED
        self._heard += 1
        return CaptureStamp(capture_ns, self._heard - 1, self._name, quality, block.timestamp)

    @property
    def counts(self) -> VoiceReceiverCounts:
        """What was counted so far."""
        return VoiceReceiverCounts(
            rtp=self._receiver.counts,
            jitter_ns=self._receiver.jitter_ns,
            playout=self._playout.counts,
            corrupt=self._corrupt,
            undated=self._undated,
            inserted_ns=self._inserted_ns,
            delay_ns=self._playout.delay_ns,
        )

    def _take_packets(self, now_ns: int) -> None:
        while (packet := self._receiver.next_event()) is not None:
            self._arrivals.append(PacketReceived(packet.timestamp, packet.received_ns))
            self._playout.handle_packet(packet)
            self._hold(packet.timestamp, now_ns)

    def _hold(self, timestamp: int, now_ns: int) -> None:
        capture_ns = self._receiver.capture_ns(timestamp)
        least_ns = self._lip_sync.least_latency_ns(now_ns)
        if capture_ns is None or least_ns is None:
            self._playout.hold(timestamp, None)
        else:
            self._playout.hold(timestamp, capture_ns + least_ns)
