"""The reports of `kontur-av send` and `kontur-av receive`."""

from kontur_av.meters import Histogram
from pipelines.report.model import Report


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


class SendReport(Report, frozen=True, kw_only=True):
    """The report of `send`; `failed` says what went wrong."""

    stream: str
    seconds: float
    cap_bps: int
    payload_bps_mean: float
    payload_bps_max_1s: float
    payload_bps_max_100ms: float
    frames_captured: int
    frames_encoded: int
    frames_sent: int
    pictures_refused: int
    rtp_packets: int
    rtp_payload_octets: int
    send_errors: int
    latency_ms: SentLatency
    source: SourceReport
    cpu_s: float
    size: tuple[int, int] | None = None
    coded_size: tuple[int, int] | None = None
    failed: list[str]


class PicturesReport(Report, frozen=True, kw_only=True):
    """The received pictures; `size` is null before the first one."""

    size: tuple[int, int] | None
    frames_received: int
    frames_damaged: int
    frames_decoded: int
    frames_corrupt: int
    frames_before_start: int
    pictures_asked_for: int


class SoundReport(Report, frozen=True, kw_only=True):
    """The received sound."""

    frames_received: int
    frames_decoded: int
    frames_corrupt: int
    frames_concealed: int
    frames_recovered: int
    frames_late: int
    frames_dropped: int
    playout_delay_ms: float


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


class RtpReport(Report, frozen=True, kw_only=True):
    """The packets that `receive` counted, and their rates."""

    stream: str
    seconds: float
    seconds_of_stream: float
    payload_bps_mean: float
    payload_bps_max_1s: float
    payload_bps_max_100ms: float
    rtp_packets: int
    rtp_lost: int
    rtp_reordered: int
    rtp_duplicates: int
    rtp_late: int
    rtp_garbage: int
    rtp_restarts: int
    rtcp_reports: int
    jitter_ms: float


class ReceiveEnd(Report, frozen=True, kw_only=True):
    """The rest of the report of `receive`; `failed` says what went wrong."""

    latency_ms: ReceivedLatency | None
    cpu_s: float
    failed: list[str]
    saved: SavedReport | None = None
    forwarded: ForwardedReport | None = None
    raw: RawReport | None = None
