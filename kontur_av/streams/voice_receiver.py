"""The receiver of a voice stream: blocks of sound, each at its instant, and their player.

`VoicePlayer` makes sound without a gap of them: decoded, recovered or concealed, and stretched.
"""

from collections import deque
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kontur_av.clock import NS_PER_S
from kontur_av.codecs.opus import OpusDecoder
from kontur_av.errors import ProtocolError
from kontur_av.media import AUDIO_CLOCK_HZ, AUDIO_PAYLOAD_TYPE, CaptureStamp, Pcm, Quality
from kontur_av.metrics import Flat, Most, Newest
from kontur_av.rtp.feedback import ReceptionReporter
from kontur_av.rtp.payload_opus import SlowClock
from kontur_av.rtp.playout import PlayoutBlock, PlayoutBuffer
from kontur_av.rtp.receiver import ReceiverCounts, RtpReceived, RtpReceiver
from kontur_av.rtp.reports import AVPF_LEAST_NS
from kontur_av.streams.lipsync import LipSync
from kontur_av.streams.reporting_receiver import ReportingReceiver

#: The most arrivals kept for a caller that takes none; the oldest is dropped.
_ARRIVALS_KEPT = 256


@dataclass(frozen=True, slots=True, kw_only=True)
class VoiceReceiverCounts:
    """The receiver of a voice, in blocks of sound."""

    rtp: Flat[ReceiverCounts] = field(default_factory=ReceiverCounts)
    #: Interarrival jitter (RFC 3550, appendix A.8).
    jitter_ns: Newest[int] = 0
    #: How long the playout holds sound back now.
    playout_delay_ns: Newest[int] = 0
    #: Blocks whose own packet came.
    frames_received: int = 0
    #: Blocks played, from their own packet or restored.
    frames_decoded: int = 0
    #: Blocks that the decoder made up.
    frames_concealed: int = 0
    #: Blocks restored from forward error correction.
    frames_recovered: int = 0
    #: Packets that were not Opus.
    frames_corrupt: int = 0
    #: Blocks before a sender report gave their capture time.
    frames_undated: int = 0
    #: Blocks too late to be played.
    frames_late: int = 0
    #: Blocks dropped to play sooner.
    frames_left_out: int = 0
    frames_stretched: int = 0
    frames_shortened: int = 0
    #: Silence inserted to play later.
    inserted_ns: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class LoudspeakerCounts:
    """A loudspeaker, in blocks of sound."""

    played: int = 0
    #: Blocks for which there was no room, or no player.
    play_dropped: int = 0
    #: How often the player ended.
    play_faults: int = 0
    #: Its last words, or why there is none.
    play_fault: str | None = None
    #: The longest time from playing a block to hearing it, as computed.
    play_delay_ms: Most[float] | None = None


class VoiceReceiver(ReportingReceiver):
    """Receives a voice as Opus over RTP. A core.

    1. Pass datagrams to `handle_packet` and `handle_report`, and call `handle_timeout` at
       `poll_timeout`.
    2. Play each block of `next_event` at once, with a `VoicePlayer`.
    3. Call `handle_sound` for its stamp.
    4. Send the datagrams of `poll_feedback` to the sender's RTCP port.

    For lip-sync call `handle_picture_shown` for pictures of the same place.

    ssrc: the receiver's own, 32 random bits; None: it sends no reports.
    name: the source in the stamps.
    wall_offset_ns: Unix time minus the caller's time; sender reports tell Unix time.
    oldest_picture_ns: the latency from which on a picture delays no sound.
    oldest_sound_ns: the largest latency that lip-sync gives a sound; 0: no lip-sync.
    payload_type: of the stream. report_interval_ns: mean time between two receiver reports.
    bandwidth_bps: of the session, of which reports take at most 5 %; None: unknown.
    capture_time_id: see `RtpReceiver`.
    """

    def __init__(
        self,
        *,
        ssrc: int | None = None,
        name: str = "voice",
        wall_offset_ns: int = 0,
        oldest_picture_ns: int = 0,
        oldest_sound_ns: int = 0,
        payload_type: int = AUDIO_PAYLOAD_TYPE,
        report_interval_ns: int = AVPF_LEAST_NS,
        bandwidth_bps: int | None = None,
        capture_time_id: int | None = None,
    ) -> None:
        receiver = RtpReceiver(
            payload_type=payload_type,
            clock_rate_hz=AUDIO_CLOCK_HZ,
            ordered=False,
            wall_offset_ns=wall_offset_ns,
            capture_time_id=capture_time_id,
        )
        reports = ReceptionReporter(
            ssrc=ssrc or 0,
            interval_ns=None if ssrc is None else report_interval_ns,
            bandwidth_bps=bandwidth_bps,
        )
        super().__init__(receiver, reports)
        self._name = name
        self._playout = PlayoutBuffer()
        self._clock = SlowClock()
        self._lip_sync = LipSync(
            oldest_picture_ns=oldest_picture_ns, oldest_sound_ns=oldest_sound_ns
        )
        self._arrivals: deque[RtpReceived] = deque(maxlen=_ARRIVALS_KEPT)
        self._heard = self._corrupt = self._undated = self._inserted_ns = 0

    def handle_packet(self, datagram: bytes, now_ns: int, source: Any = None) -> None:
        """As of every stream; its block can be due at once."""
        super().handle_packet(datagram, now_ns, source)
        self._take_packets(now_ns)

    def handle_report(self, datagram: bytes, now_ns: int) -> bool:
        """As of every stream; it dates blocks that wait."""
        dates = super().handle_report(datagram, now_ns)
        self._take_packets(now_ns)
        return dates

    def handle_picture_shown(self, shown_ns: int, latency_ns: int) -> None:
        """A picture of the same place was shown, `latency_ns` after its capture."""
        self._lip_sync.handle_picture(shown_ns, latency_ns)

    def handle_timeout(self, now_ns: int) -> None:
        """Make events of the blocks due by `now_ns`. Drain `next_event` afterwards."""
        self._playout.handle_timeout(now_ns)

    def poll_timeout(self) -> int | None:
        """Return when the next block or report is due; None: not yet."""
        due = (self._playout.poll_timeout(), self._reports.poll_timeout())
        return min((due_ns for due_ns in due if due_ns is not None), default=None)

    def poll_feedback(self, now_ns: int) -> bytes | None:
        """Return an RTCP datagram to send to the stream's sender now, or None."""
        if not self._reports.is_due(now_ns):
            return None
        return self._reports.report(self.report_block(now_ns), now_ns)

    def next_event(self) -> PlayoutBlock | None:
        """Return the next block that is due, with an Opus packet or to be concealed, or None."""
        return self._playout.next_event()

    def take_arrivals(self) -> list[RtpReceived]:
        """Return the packets that have come since the last call, also those not played."""
        arrivals = list(self._arrivals)
        self._arrivals.clear()
        return arrivals

    def handle_sound(
        self, block: PlayoutBlock, *, decoded: bool, capture_ns: int | None
    ) -> CaptureStamp | None:
        """Return the stamp of a block that is played; None if `capture_ns` is None.

        decoded: False if it was concealed, because it was lost or no Opus.
        capture_ns: the result of `capture_ns` for the block's timestamp.
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
        """The counts so far."""
        playout = self._playout.counts
        return VoiceReceiverCounts(
            rtp=replace(self._receiver.counts),
            jitter_ns=self._receiver.jitter_ns,
            playout_delay_ns=self._playout.delay_ns,
            frames_received=playout.played + playout.late + playout.dropped,
            frames_decoded=playout.played + playout.recovered - self._corrupt,
            frames_concealed=playout.concealed + self._corrupt,
            frames_recovered=playout.recovered,
            frames_corrupt=self._corrupt + playout.garbage,
            frames_undated=self._undated,
            frames_late=playout.late,
            frames_left_out=playout.dropped,
            frames_stretched=playout.stretched,
            frames_shortened=playout.shortened,
            inserted_ns=self._inserted_ns,
        )

    def _take_packets(self, now_ns: int) -> None:
        while (packet := self._receiver.next_event()) is not None:
            if not packet.payload:
                continue  # padding that probes the path
            if (scale := self._clock.handle_packet(packet)) != 1:
                self._receiver.scale_timestamps(scale)
                packet = packet._replace(
                    timestamp=packet.timestamp * scale & 0xFFFF_FFFF, restart=True
                )
            self._arrivals.append(packet)
            self._playout.handle_packet(packet)
            self._hold(packet.timestamp, now_ns)

    def _hold(self, timestamp: int, now_ns: int) -> None:
        capture_ns = self._receiver.capture_ns(timestamp)
        least_ns = self._lip_sync.least_latency_ns(now_ns)
        if capture_ns is None or least_ns is None:
            self._playout.hold(timestamp, None)
        else:
            self._playout.hold(timestamp, capture_ns + least_ns)


#: Samples of the block before that a cubic needs. They delay sound by two samples (42 µs).
_TAIL = 3
#: A change of length by more than this part happens in pauses only. There missing sound cannot be
#: heard, but another pitch could be.
_RESAMPLED = 40


class VoicePlayer:
    """Turns each block of a `PlayoutBuffer`, in order, into exactly `played_samples` samples."""

    def __init__(self) -> None:
        self._decoder = OpusDecoder()
        self._tail: NDArray[np.int16] = np.zeros(_TAIL, np.int16)

    def play(self, block: PlayoutBlock) -> tuple[Pcm, bool]:
        """Return the block's sound, int16, shape (block.played_samples,), and whether it is real.

        False: it is concealment, because the packet was lost or no Opus.
        """
        sound = self._received(block)
        if sound is not None:
            return self._fitted(sound, block.played_samples), True
        # libopus conceals in steps of 2.5 ms only; the rest is cut off.
        sound = self._decoder.conceal(-(-block.samples // 120) * 120)[: block.samples]
        return self._fitted(sound, block.played_samples), False

    def _received(self, block: PlayoutBlock) -> Pcm | None:
        if block.payload is None:
            return None
        try:
            if block.recovered:
                return self._decoder.recover(block.payload, block.samples)
            return self._decoder.decode(block.payload)
        except ProtocolError:
            return None

    def _fitted(self, sound: Pcm, count: int) -> Pcm:
        """Return `sound` resampled to `count` samples by Catmull-Rom interpolation."""
        line = np.concatenate([self._tail, sound])
        self._tail = line[-_TAIL:]
        if count == len(sound):
            return line[1 : 1 + count]
        if abs(count - len(sound)) > len(sound) // _RESAMPLED:
            return _blended(line[1 : 1 + len(sound)], count)
        at = 1 + np.arange(count) * (len(sound) / count)
        index = at.astype(np.int64)
        t = at - index
        p0, p1, p2, p3 = (line[index + k].astype(np.float64) for k in (-1, 0, 1, 2))
        curve = p1 + 0.5 * t * (
            p2 - p0 + t * (2 * p0 - 5 * p1 + 4 * p2 - p3 + t * (3 * (p1 - p2) + p3 - p0))
        )
        return np.clip(np.rint(curve), -32768, 32767).astype(np.int16)


def _blended(sound: Pcm, count: int) -> Pcm:
    """Return `sound` in `count` samples: its beginning fades into its end where they overlap."""
    length = len(sound)
    begin, end = max(0, count - length), min(length, count)
    weight = (np.arange(begin, end) - begin + 0.5) / (end - begin)
    blended = np.empty(count, np.int16)
    blended[:begin] = sound[:begin]
    blended[end:] = sound[end - count :] if end < count else sound[:0]
    head, tail = sound[begin:end], sound[length - count + begin : length - count + end]
    blended[begin:end] = np.rint(head * (1 - weight) + tail * weight)
    return blended
