"""What a killed recorder and a cut file lose, and what a recording costs. A core."""

from collections.abc import Sequence
from dataclasses import dataclass
from statistics import median

from mcap.opcode import Opcode
from mcap.records import Metadata

from benchmarks.json_reader import JsonReader
from kontur_av.clock import NS_PER_S
from pipelines.recording.mcap_stream import HEAD, MAGIC
from pipelines.recording.metadata import METADATA, RecordingMetadata
from pipelines.recording.scan import FoundMessage, Scan
from pipelines.report.result import Headline, spread

#: What is promised.
MOST_LOST_S, MOST_CORES = 1.0, 0.15
VIDEO = "uplink_video"


@dataclass(frozen=True, slots=True, kw_only=True)
class ScannedPart:
    """A part of a recording, as a linear scan reads it.

    first_ns, last_ns: session clock, of its messages; None without any. torn_octets: unread, at its
    end. damaged: something else than its end cannot be read. missing: gaps in the numbers of
    haptic messages.
    """

    part: int
    messages: int
    first_ns: int | None
    last_ns: int | None
    torn_octets: int
    damaged: bool
    missing: int


def scan_part(octets: memoryview) -> ScannedPart:
    """Read a part, torn or whole. ValueError if it does not say which one it is."""
    scan, metadata, first_ns, last_ns, missing = Scan(octets), None, None, None, 0
    numbers: dict[str, int] = {}
    for item in scan.items():
        if isinstance(item, Metadata) and item.name == METADATA:
            metadata = RecordingMetadata.of(item.metadata)
        if not isinstance(item, FoundMessage):
            continue
        at_ns, topic = item.message.log_time, item.channel.topic
        first_ns = at_ns if first_ns is None else min(first_ns, at_ns)
        last_ns = at_ns if last_ns is None else max(last_ns, at_ns)
        if topic.startswith("/haptic/"):
            missing += max(0, item.message.sequence - numbers.get(topic, item.message.sequence) - 1)
            numbers[topic] = item.message.sequence
    if metadata is None:
        raise ValueError("a part without facts")
    offset_ns = metadata.wall_ns - metadata.session_ns
    metrics = scan.metrics
    tail = sum(end - begin for begin, end in metrics.holes if end == len(octets))
    return ScannedPart(
        part=metadata.part,
        messages=metrics.messages,
        first_ns=None if first_ns is None else first_ns - offset_ns,
        last_ns=None if last_ns is None else last_ns - offset_ns,
        torn_octets=tail,
        damaged=metrics.unread_octets != tail or metrics.orphans > 0,
        missing=missing,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Kill:
    """A recorder was killed. lost_s: from its last message in the file to the kill.

    gap_s: from that message to the first one of the next part. damaged: something before it cannot
    be read. missing: haptic messages that this part lacks between others.
    """

    lost_s: float
    gap_s: float | None
    damaged: bool
    missing: int


def kill_of(killed_ns: int, torn: ScannedPart, after: ScannedPart | None) -> Kill:
    """Compare a torn part with the instant of the kill. killed_ns: session clock."""
    last_ns = torn.last_ns if torn.last_ns is not None else killed_ns
    gap_s = None
    if after is not None and after.first_ns is not None:
        gap_s = (after.first_ns - last_ns) / NS_PER_S
    return Kill(
        lost_s=(killed_ns - last_ns) / NS_PER_S,
        gap_s=gap_s,
        damaged=torn.damaged,
        missing=torn.missing,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Cuts:
    """A file was cut at many octets of its last chunk.

    lost_s: the most that was lost of what had come. damaged: cuts after which an earlier message
    was missing.
    """

    octets: int
    cuts: int
    lost_s: float
    damaged: int


def cut(whole: bytes, cuts: int) -> Cuts:
    """Cut a whole recording at `cuts` octets of its last chunk, spread evenly; 0: at every one.

    Only its head and its last two chunks are read each time, because the rest is the same.
    """
    starts = _chunks(whole)
    *_, before, (begin, end) = starts
    head = whole[: starts[0][0]] + whole[before[0] : before[1]]
    last = whole[begin:end]
    sure = scan_part(memoryview(head))
    all_of_it = scan_part(memoryview(head + last))
    places = range(len(last)) if not cuts else sorted({k * len(last) // cuts for k in range(cuts)})
    damaged, lost_ns = 0, 0
    for place in places:
        found = scan_part(memoryview(head + last[:place]))
        damaged += found.messages < sure.messages or found.damaged
        assert found.last_ns is not None and all_of_it.last_ns is not None
        lost_ns = max(lost_ns, all_of_it.last_ns - found.last_ns)
    return Cuts(octets=len(last), cuts=len(places), lost_s=lost_ns / NS_PER_S, damaged=damaged)


def _chunks(whole: bytes) -> list[tuple[int, int]]:
    """First octet and end of each chunk, its indexes included."""
    found: list[tuple[int, int]] = []
    at = len(MAGIC)
    while at + HEAD.size <= len(whole):
        opcode, length = HEAD.unpack_from(whole, at)
        end = at + HEAD.size + length
        if opcode == Opcode.DATA_END:
            break
        if opcode == Opcode.CHUNK:
            found.append((at, end))
        elif opcode == Opcode.MESSAGE_INDEX and found:
            found[-1] = found[-1][0], end
        at = end
    if len(found) < 2:
        raise ValueError("the recording is too short: it has fewer than two chunks")
    return found


@dataclass(frozen=True, slots=True, kw_only=True)
class SessionCost:
    """A session, recorded or not. lateness_us: the later of both gateways' slots, p99.

    recorder_cores: CPU seconds of the recorder a second. lost: messages not in the file.
    """

    lateness_us: float
    video_p50_ms: float | None
    video_p99_ms: float | None
    cores: float
    recorder_cores: float
    lost: int


def read_session(report: JsonReader) -> SessionCost:
    """The figures of one session's report. ValueError if it is no report of a session."""
    latency = report.at("streams", VIDEO, "latency_ms")
    came = latency.number("count") > 0
    seconds = report.number("seconds")
    lost = 0
    if report.has("recorder"):
        for _, channel in report.items("recorder", "channels"):
            lost += channel.count("missed") + channel.count("dropped")
    return SessionCost(
        lateness_us=max(link.number("lateness_us", "p99") for _, link in report.items("link")),
        video_p50_ms=latency.number("p50") if came else None,
        video_p99_ms=latency.number("p99") if came else None,
        cores=report.number("cpu", "total_s") / seconds,
        recorder_cores=report.number("processes", "recorder", "cpu_s") / seconds,
        lost=lost,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordResult:
    """All of it. without, recorded: sessions in turn, in pairs.

    differing: figures of the newest recording that are not those of its report.
    """

    setup: str
    seconds: float
    kills: tuple[Kill, ...]
    cuts: Cuts | None
    without: tuple[SessionCost, ...]
    recorded: tuple[SessionCost, ...]
    differing: int | None = None

    @property
    def sound(self) -> bool:
        """Whether nothing was lost that was promised to be kept."""
        lost = [kill.lost_s for kill in self.kills] + ([self.cuts.lost_s] if self.cuts else [])
        damaged = any(kill.damaged for kill in self.kills) or bool(self.cuts and self.cuts.damaged)
        return not damaged and all(one <= MOST_LOST_S for one in lost)


def headlines(result: RecordResult) -> list[Headline]:
    """The figures for the page of measurements."""
    found: list[Headline] = []
    if result.kills:
        lost = spread([kill.lost_s for kill in result.kills])
        gaps = [kill.gap_s for kill in result.kills if kill.gap_s is not None]
        group = f"{len(result.kills)} kills of the recorder"
        target = f"at most {MOST_LOST_S:g} s"
        found += [
            Headline(group=group, what="lost, median", unit="s", value=lost.p50),
            Headline(
                group=group,
                what="lost, most",
                unit="s",
                value=lost.max,
                target=target,
                met=lost.max <= MOST_LOST_S,
            ),
            Headline(
                group=group,
                what="files damaged before that",
                unit="",
                value=sum(kill.damaged for kill in result.kills),
                target="0",
                met=not any(kill.damaged for kill in result.kills),
            ),
        ]
        missing = sum(kill.missing for kill in result.kills)
        found.append(
            Headline(group=group, what="haptic messages missing before", unit="", value=missing)
        )
        if gaps:
            longest = max(gaps)
            what = "from the last message to the first of the next part, most"
            found.append(Headline(group=group, what=what, unit="s", value=longest))
    if result.cuts is not None:
        cuts = result.cuts
        group = f"the file cut at {cuts.cuts} octets of its last chunk"
        found += [
            Headline(
                group=group,
                what="lost, most",
                unit="s",
                value=cuts.lost_s,
                target=f"at most {MOST_LOST_S:g} s",
                met=cuts.lost_s <= MOST_LOST_S,
            ),
            Headline(
                group=group,
                what="earlier messages lost",
                unit="",
                value=cuts.damaged,
                target="0",
                met=not cuts.damaged,
            ),
        ]
    if result.recorded:
        cores = median(one.recorder_cores for one in result.recorded)
        group = f"{result.setup}, sessions of {result.seconds:g} s in turn"
        found.append(
            Headline(
                group=group,
                what="CPU of the recorder",
                who="recorded",
                unit="cores",
                value=cores,
                target=f"at most {MOST_CORES:g}",
                met=cores <= MOST_CORES,
            )
        )
        for who, runs in (("not recorded", result.without), ("recorded", result.recorded)):
            found += [
                Headline(group=group, what=what, who=who, unit=unit, value=_middle(values))
                for what, unit, values in (
                    ("lateness of slots, p99", "µs", [run.lateness_us for run in runs]),
                    (f"{VIDEO}, p50", "ms", [run.video_p50_ms for run in runs]),
                    (f"{VIDEO}, p99", "ms", [run.video_p99_ms for run in runs]),
                    ("CPU of the session", "cores", [run.cores for run in runs]),
                )
            ]
        lacking = sum(run.lost for run in result.recorded)
        found.append(
            Headline(
                group=group,
                what="messages lost",
                who="recorded",
                unit="",
                value=lacking,
                target="0",
                met=not lacking,
            )
        )
    if result.differing is not None:
        found.append(
            Headline(
                group=f"{result.setup}, sessions of {result.seconds:g} s in turn",
                what="figures of the file that are not those of the report",
                who="recorded",
                unit="",
                value=result.differing,
                target="0",
                met=not result.differing,
            )
        )
    return found


def _middle(values: Sequence[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return median(known) if known else None
