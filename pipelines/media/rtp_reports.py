"""The report of `kontur-av receive`."""

from kontur_av.codecs.decoder import DecoderCounts
from kontur_av.metrics import Flat
from kontur_av.report import Latency, PayloadRates, Report
from kontur_av.streams.video_receiver import VideoReceiverCounts
from kontur_av.streams.voice_receiver import LoudspeakerCounts, VoiceReceiverCounts


class ReceivedStages(Report, frozen=True, kw_only=True):
    """Latencies since the capture."""

    capture_to_received: Latency


class ReceivedLatency(Latency, frozen=True, kw_only=True):
    """From the capture to the decoded picture or sound; `clock` says which clocks were compared."""

    stages: ReceivedStages
    clock: str


class SavedReport(Report, frozen=True, kw_only=True):
    """The file of `--save`."""

    file: str
    packets: int


class ForwardedReport(Report, frozen=True, kw_only=True):
    """What `--to` handed on. left_out: access units or packets of sound that did not go there.

    They came while there was no connection, before a key picture, or were not taken in time.
    connections: how often the stream began there. faults: attempts or connections that failed.
    """

    to: str
    packets: int
    left_out: int
    connections: int
    faults: int
    last_fault: str


class RawReport(Report, frozen=True, kw_only=True):
    """The pictures that `--raw` wrote or dropped."""

    file: str
    pictures: int
    dropped: int
    readers_gone: int


class PlayedReport(Report, frozen=True, kw_only=True):
    """What `--play` did, and how late the player has sound heard."""

    to: str
    counts: Flat[LoudspeakerCounts]
    delay_ms: Latency | None


class OutputReport(Report, frozen=True, kw_only=True):
    """What came out of a receiver of pictures, or of one of sound. size: none before a picture."""

    video: Flat[VideoReceiverCounts] | None = None
    decoder: Flat[DecoderCounts] | None = None
    size: tuple[int, int] | None = None
    voice: Flat[VoiceReceiverCounts] | None = None


class ReceiveReport(PayloadRates, frozen=True, kw_only=True):
    """The report of `receive`; `failed` says what went wrong."""

    stream: str
    seconds: float
    seconds_of_stream: float
    output: Flat[OutputReport]
    latency_ms: ReceivedLatency | None
    cpu_s: float
    failed: list[str]
    saved: SavedReport | None = None
    forwarded: ForwardedReport | None = None
    raw: RawReport | None = None
    played: PlayedReport | None = None
