"""Whether a recording says the same as the report of its session. A core.

For a session that was recorded from its begin to its end, in which no process was started again.
The recorder joins a moment after the others and leaves before them. So what is counted without a
pause, as frames and haptic samples, may differ by what comes in a quarter of a second.
"""

from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmarks.json_reader import JsonReader
from kontur_av.clock import NS_PER_MS
from pipelines.recording.recorded_messages import (
    NO_SAMPLE,
    LinkReceived,
    LinkSent,
    RecordedSound,
    UnitMetadata,
    unpack,
    unpack_haptics,
)

#: Samples and frames of a quarter of a second, at 1 kHz.
_EDGE = 250
#: A report takes a picture's instant where it is displayed, a file where it is decoded.
_VIDEO_MS, _VIDEO_P95_MS, _VOICE_MS, _CYCLE_MS = 2.0, 5.0, 1.0, 1.0
#: A display that is late shows only the newest picture.
_NOT_SHOWN = 0.01
#: An access unit has start codes and parameter sets that are no payload of RTP.
_VIDEO_RATE, _VOICE_RATE = 0.03, 0.002
_NUMBERS = 1 << 16


@dataclass(frozen=True, slots=True, kw_only=True)
class Comparison:
    """A figure of both. allowed: by how much they may differ."""

    what: str
    unit: str
    file: float
    report: float
    allowed: float

    @property
    def agrees(self) -> bool:
        """Whether the difference is allowed."""
        return abs(self.file - self.report) <= self.allowed


class Recount:
    """Counts a recording, part after part in the order of the files."""

    def __init__(self) -> None:
        self.messages: Counter[str] = Counter()
        #: By channel: octets; and latencies in ms of what has a date.
        self.octets: Counter[str] = Counter()
        self.units: Counter[str] = Counter()
        self.latencies_ms: defaultdict[str, list[float]] = defaultdict(list)
        self.newest_sent: dict[str, LinkSent] = {}
        self.newest_received: dict[str, LinkReceived] = {}
        self._cycles: defaultdict[str, list[NDArray[np.void]]] = defaultdict(list)

    def handle_message(self, topic: str, log_ns: int, publish_ns: int, data: bytes) -> None:
        """Count a message. log_ns, publish_ns: wall time."""
        self.messages[topic] += 1
        late_ms = (publish_ns - log_ns) / NS_PER_MS
        name, *rest = topic.strip("/").split("/")
        if not rest:
            return
        way, *rest = rest
        if rest == ["facts"]:
            metadata = unpack(UnitMetadata, data)
            if metadata.added:
                return
            channel = f"/{name}/{way}"
            self.units[channel] += 1
            self.octets[channel] += metadata.octets
            if metadata.dated and not metadata.refused:
                self.latencies_ms[channel].append(late_ms)
        elif name.endswith("_voice"):
            self.units[topic] += 1
            self.octets[topic] += len(unpack(RecordedSound, data).data)
            if late_ms:
                self.latencies_ms[topic].append(late_ms)
        elif name == "haptic":
            self._cycles[topic].append(unpack_haptics(data))
        elif name == "link" and rest == ["sent"]:
            self.newest_sent[way] = unpack(LinkSent, data)
        elif name == "link" and rest == ["received"]:
            self.newest_received[way] = unpack(LinkReceived, data)

    def samples_sent(self, key: str) -> tuple[int, int]:
        """Samples that a direction had sent by its last cycle, and numbers that are missing."""
        numbers = self._of(f"/haptic/{key}/sent")["sequence"].astype(np.int64)
        numbers = numbers[numbers != NO_SAMPLE]
        if not len(numbers):
            return 0, 0
        steps = np.diff(numbers) % _NUMBERS
        return int(numbers[0] + steps.sum()) + 1, int((steps - 1).sum())

    def delays_ms(self, key: str) -> NDArray[np.float64]:
        """From the cycle that sent each sample to the first that acted on it."""
        sent, acted = self._of(f"/haptic/{key}/sent"), self._of(f"/haptic/{key}/received")
        sent = sent[sent["sequence"] != NO_SAMPLE]
        if not len(sent):
            return np.empty(0)
        acted = acted[acted["sequence"] != NO_SAMPLE]
        first = np.diff(acted["sequence"], prepend=NO_SAMPLE) != 0
        acted = acted[first]
        # Numbers without their wrap; one that was acted on is the newest of its value.
        counts = np.cumsum(np.diff(sent["sequence"].astype(np.int64), prepend=0) % _NUMBERS)
        newest = np.searchsorted(sent["time_ns"], acted["time_ns"], side="right") - 1
        back = (counts[newest] - acted["sequence"]) % _NUMBERS
        place = np.searchsorted(counts, counts[newest] - back)
        known = (newest >= 0) & (counts[newest] - back >= counts[0])
        late_ns = acted["time_ns"][known] - sent["time_ns"][place[known]]
        found: NDArray[np.float64] = late_ns / NS_PER_MS
        return found

    def _of(self, topic: str) -> NDArray[np.void]:
        return np.concatenate([unpack_haptics(b""), *self._cycles[topic]])


def compare(recount: Recount, report: JsonReader) -> list[Comparison]:
    """Compare counts, rates, losses and latencies. ValueError if it is no report of a session."""
    found = [*_kept(recount, report)]
    for name, stream in report.items("streams"):
        found += _stream(recount, name, stream, report.number("seconds"))
    for key, way in report.items("haptic"):
        found += _haptics(recount, key, way)
    for direction, link in report.items("link"):
        if direction in recount.newest_received:
            found += _link(recount, direction, link)
    return found


def _kept(recount: Recount, report: JsonReader) -> Iterator[Comparison]:
    channels = dict(report.items("recorder", "channels"))
    for topic in sorted({*channels, *recount.messages}):
        channel = channels.get(topic)
        kept = 0 if channel is None else channel.count("kept")
        yield Comparison(
            what=f"{topic}, messages",
            unit="",
            file=recount.messages[topic],
            report=kept,
            allowed=0,
        )


def _stream(
    recount: Recount, name: str, stream: JsonReader, seconds: float
) -> Iterator[Comparison]:
    video = stream.has("coded_size")
    sent, received = f"/{name}/sent", f"/{name}/received"
    late_ms = recount.latencies_ms[received]
    shown = stream.count("frames_displayed")
    for what, file, told, allowed in (
        ("units sent", recount.units[sent], stream.count("frames_sent"), 1),
        ("units shown", len(late_ms), shown, 1 + _NOT_SHOWN * shown),
    ):
        yield Comparison(what=f"{name}, {what}", unit="", file=file, report=told, allowed=allowed)
    mean_bps = stream.number("payload_bps_mean")
    share = _VIDEO_RATE if video else _VOICE_RATE
    yield Comparison(
        what=f"{name}, payload",
        unit="bit/s",
        file=recount.octets[sent] * 8 / seconds,
        report=mean_bps,
        allowed=share * mean_bps,
    )
    if video:
        yield from _latency(name, late_ms, stream, _VIDEO_MS, _VIDEO_P95_MS)
    else:
        yield from _latency(name, late_ms, stream, _VOICE_MS, _VOICE_MS)


def _latency(
    name: str,
    late_ms: Sequence[float] | NDArray[np.float64],
    told: JsonReader,
    allowed_ms: float,
    allowed_p95_ms: float,
) -> Iterator[Comparison]:
    if not len(late_ms) or not told.count("latency_ms", "count"):
        return
    for share, allowed in ((50, allowed_ms), (95, allowed_p95_ms)):
        yield Comparison(
            what=f"{name}, latency p{share}",
            unit="ms",
            file=float(np.percentile(late_ms, share)),
            report=told.number("latency_ms", f"p{share}"),
            allowed=allowed,
        )


def _haptics(recount: Recount, key: str, told: JsonReader) -> Iterator[Comparison]:
    name = f"haptic_{key}"
    sent, missing = recount.samples_sent(key)
    yield Comparison(
        what=f"{name}, samples sent", unit="", file=sent, report=told.count("sent"), allowed=_EDGE
    )
    yield Comparison(
        what=f"{name}, numbers missing in the file", unit="", file=missing, report=0, allowed=0
    )
    yield from _latency(name, recount.delays_ms(key), told, _CYCLE_MS, _CYCLE_MS)


def _link(recount: Recount, direction: str, told: JsonReader) -> Iterator[Comparison]:
    sent, received = recount.newest_sent[direction], recount.newest_received[direction]
    dropped = sum(reason.count() for _, reason in told.items("frames_dropped"))
    for what, file, report in (
        ("frames", sent.frames, told.count("frames")),
        ("frames lost", received.frames_lost, told.count("frames_lost")),
        ("frames refused", received.frames_dropped, dropped),
    ):
        yield Comparison(
            what=f"{direction}, {what}", unit="", file=file, report=report, allowed=_EDGE
        )
    carried = {each.what: each.octets for each in sent.carried}
    for what, octets in told.items("octets"):
        # Idle fill takes the most; of each kind no more than a quarter of a second's rate.
        yield Comparison(
            what=f"{direction}, octets of {what}",
            unit="",
            file=carried.get(what, 0),
            report=octets.count(),
            allowed=_EDGE * max(32, octets.count() / max(1, sent.frames)),
        )
