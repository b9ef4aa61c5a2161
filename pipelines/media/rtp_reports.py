"""The reports of `kontur-av send` and `kontur-av receive`."""

from kontur_av.codecs.decoder import DecoderCounts
from kontur_av.meters import Histogram
from kontur_av.metrics import Flat
from kontur_av.streams.paced_sender import SenderCounts
from kontur_av.streams.video_receiver import VideoReceiverCounts
from kontur_av.streams.voice_receiver import VoiceReceiverCounts
from pipelines.session.session_metrics import Report


class Latency(Report, frozen=True, kw_only=True):
    """Percentiles of a latency by nearest rank in a histogram."""

    p50: float
    p95: float
    p99: float
    max: float


def latency_ms(histogram: Histogram) -> Latency:
    """The latencies of a histogram of values in ns, in ms."""
    return Latency(**histogram.summary_ms())


class SentStages(Report, frozen=True, kw_only=True):
    """Latencies since the capture; of sound, without the codec's look-ahead."""

    capture_to_encoded: Latency
    capture_to_sent: Latency


class SentLatency(Report, frozen=True, kw_only=True):
    """The latencies of `send`."""

    stages: SentStages


class SourceReport(Report, frozen=True, kw_only=True):
    """The faults of the source; `last_fault` is empty if there was none."""

    faults: int
    last_fault: str
    #: What dates its pictures: `source` (the camera itself) or `arrival`; of cameras only.
    dated_by: str | None = None


class SendReport(Report, frozen=True, kw_only=True):
    """The report of `send`; `failed` says what went wrong."""

    stream: str
    seconds: float
    cap_bps: int
    payload_bps_mean: float
    payload_bps_max_1s: float
    payload_bps_max_100ms: float
    sender: Flat[SenderCounts]
    rtp_payload_octets: int
    send_errors: int
    latency_ms: SentLatency
    source: SourceReport
    cpu_s: float
    size: tuple[int, int] | None = None
    coded_size: tuple[int, int] | None = None
    #: The library that codes the pictures, in words.
    encoder: str | None = None
    failed: list[str]


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


class OutputReport(Report, frozen=True, kw_only=True):
    """What came out of a receiver of pictures, or of one of sound. size: none before a picture."""

    video: Flat[VideoReceiverCounts] | None = None
    decoder: Flat[DecoderCounts] | None = None
    size: tuple[int, int] | None = None
    voice: Flat[VoiceReceiverCounts] | None = None


class ReceiveReport(Report, frozen=True, kw_only=True):
    """The report of `receive`; `failed` says what went wrong."""

    stream: str
    seconds: float
    seconds_of_stream: float
    payload_bps_mean: float
    payload_bps_max_1s: float
    payload_bps_max_100ms: float
    output: Flat[OutputReport]
    latency_ms: ReceivedLatency | None
    cpu_s: float
    failed: list[str]
    saved: SavedReport | None = None
    forwarded: ForwardedReport | None = None
    raw: RawReport | None = None
