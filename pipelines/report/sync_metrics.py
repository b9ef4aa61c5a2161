"""Sight, hearing and touch compared by what they show, not by what their stamps say.

A contact in the world lights an LED, sounds a click and steps the force in one instant. Each is
found again where it is seen, heard and felt (`watching`, `telepresence.haptics.step_detector`),
joined to its contact (`sync_matching`), and judged. From that come latencies and skews.
"""

from bisect import bisect_left
from collections import Counter, defaultdict, deque
from collections.abc import Callable, Collection, Container, Iterable, Sequence
from dataclasses import dataclass
from itertools import accumulate
from typing import Any

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.meters import rank_of
from kontur_av.streams.lipsync import EARLIEST_NS, LATEST_NS
from pipelines.media.showing import WATCHED
from pipelines.report.model import ContentSkew, ListedContact, Ranks, SenseReport, SyncReport
from pipelines.report.sync_matching import Matched, judge, match
from pipelines.session.probe import Series
from pipelines.session.session_metrics import ClickRow, ContactRow, LightRow, StepRow
from pipelines.session.setup.table import GROUND_MIC, Setup
from telepresence.world import CONTACT_SCENES

#: The senses, and what carries them to the operator.
SENSES = {**WATCHED, "force": "haptic_up"}
#: The rows that processes report of contacts and of what was perceived.
PERCEIVED = frozenset({ContactRow, LightRow, ClickRow, StepRow})
_SENSE_OF = {LightRow: "light", ClickRow: "click"}
#: The pairs of the report: how much later the first comes than the second.
PAIRS = {
    "video_haptic": ("light", "force"),
    "audio_haptic": ("click", "force"),
    "audio_video": ("click", "light"),
}

#: A contact sooner than this after another one is a bounce.
_BOUNCE_NS = 300 * NS_PER_MS
#: A contact in this last part of the known time may not have been perceived yet.
_TIMEOUT_NS = NS_PER_S
#: At this many contacts, or detections of a sense, the older half is settled.
_DEPTH = 8192
#: Settled durations are rounded to this, which bounds their memory.
_GRAIN_NS = NS_PER_MS // 10
#: At most this many contacts are listed one by one.
_LISTED = 1000


@dataclass(frozen=True, slots=True)
class SensedEvent:
    """A contact with a target: its instant, its LED, and what was perceived of it by sense."""

    instant_ns: int
    led: int
    perceived: dict[str, Matched | None]

    def latency_ns(self, sense: str) -> int | None:
        """From the contact to its perception; None if it was missed."""
        found = self.perceived[sense]
        return None if found is None else found.instant_ns - self.instant_ns


class _Tally:
    """Sums over contacts.

    durations: how often each (ns) came; by `latency`, `stamped` and `error` of a sense, and by
    `skew` of a pair.
    """

    def __init__(self, base: "_Tally | None" = None) -> None:
        self.events: int = 0 if base is None else base.events
        self.durations: defaultdict[tuple[str, str], Counter[int]] = defaultdict(Counter)
        if base is not None:
            self.durations.update((key, counted.copy()) for key, counted in base.durations.items())

    def add(self, events: Sequence[SensedEvent], grain_ns: int = 1) -> None:
        """Count events, with durations to the nearest multiple of `grain_ns`."""

        def count(what: str, of: str, value_ns: int) -> None:
            self.durations[what, of][round(value_ns / grain_ns) * grain_ns] += 1

        self.events += len(events)
        for event in events:
            for sense, found in event.perceived.items():
                if found is None:
                    continue
                count("latency", sense, found.instant_ns - event.instant_ns)
                if found.stamp_ns is not None:
                    count("stamped", sense, found.instant_ns - found.stamp_ns)
                    count("error", sense, found.stamp_ns - event.instant_ns)
        for pair in PAIRS:
            for skew_ns in skews_ns(pair, events):
                count("skew", pair, skew_ns)


class SyncMetrics:
    """Takes contacts and detections, in any order; `report` joins them.

    soonest_ns: the least delay of the radio.

    In a long session older contacts are settled: their perceptions are counted in steps of 0.1 ms,
    and no verdict on stamps uses them.
    """

    def __init__(self, *, soonest_ns: int = 0) -> None:
        self._soonest_ns = soonest_ns
        self._contacts: deque[tuple[int, int]] = deque(maxlen=_DEPTH)
        self._found: dict[str, deque[Matched]] = {sense: deque(maxlen=_DEPTH) for sense in SENSES}
        #: Detections in all, by sense.
        self._count: Counter[str] = Counter()
        #: Steps of the force whose samples' stamps are not known yet.
        self._steps: deque[int] = deque(maxlen=_DEPTH)
        #: Everything up to this instant is known.
        self._now_ns = -(1 << 62)
        self._settled = _Tally()
        self._settled_beside = self._settled_bounces = 0
        #: The first contact with a target.
        self._first_ns: int | None = None

    def handle_series(self, series: Series[Any]) -> None:
        """Rows of one of `PERCEIVED`, as a process reports them."""
        for row in series.rows():
            if isinstance(row, ContactRow):
                self._contacts.append((row.instant_ns, row.led))
            elif isinstance(row, StepRow):
                self._steps.append(row.instant_ns)
            elif series.stream == WATCHED[_SENSE_OF[series.kind]]:
                found = Matched(row.instant_ns, float(row.strength), row.capture_ns, row.slack_ns)
                self._add(_SENSE_OF[series.kind], found)

    def handle_time(self, now_ns: int, sent_ns_at: Callable[[int], int | None]) -> None:
        """The time is `now_ns`. sent_ns_at: when the force that was felt at an instant was sent."""
        self._now_ns = max(self._now_ns, now_ns)
        steps = self._steps
        # By then both ends of the samples have reported their stamps.
        while steps and steps[0] <= now_ns - _TIMEOUT_NS:
            instant_ns = steps.popleft()
            self._add("force", Matched(instant_ns, stamp_ns=sent_ns_at(instant_ns)))
        if len(self._contacts) == _DEPTH:
            self._settle(self._contacts[_DEPTH // 2][0])
        for found in self._found.values():
            if len(found) == _DEPTH:
                self._settle(found[_DEPTH // 2].instant_ns)

    def _add(self, sense: str, found: Matched) -> None:
        self._found[sense].append(found)
        self._count[sense] += 1

    def _settle(self, until_ns: int) -> None:
        """Count the contacts before an instant, and forget them and their detections."""
        events, (apart, _) = self._events(SENSES), self._apart()
        # Cut between two groups of bounces, so that no bounce is counted as a contact.
        until_ns = min((at_ns for at_ns, _ in apart if at_ns >= until_ns), default=until_ns)
        self._note_first(events)
        self._settled.add([event for event in events if event.instant_ns < until_ns], _GRAIN_NS)
        apart = [one for one in apart if one[0] < until_ns]
        self._settled_beside += sum(led < 0 for _, led in apart)
        self._settled_bounces += sum(at_ns < until_ns for at_ns, _ in self._contacts) - len(apart)
        self._contacts = deque((c for c in self._contacts if c[0] >= until_ns), _DEPTH)
        for sense, found in self._found.items():
            late = (one for one in found if one.instant_ns >= until_ns + self._soonest_ns)
            self._found[sense] = deque(late, _DEPTH)

    def _events(self, senses: Collection[str]) -> list[SensedEvent]:
        """Every contact with a target that is not settled, by its instant, without bounces."""
        contacts, _ = self._apart()
        instants = [instant_ns for instant_ns, _ in contacts]
        nothing: list[Matched | None] = [None] * len(instants)
        matched = {
            sense: match(instants, self._sorted(sense), soonest_ns=self._soonest_ns)
            if sense in senses
            else nothing
            for sense in SENSES
        }
        return [
            SensedEvent(instant_ns, led, {sense: matched[sense][index] for sense in SENSES})
            for index, (instant_ns, led) in enumerate(contacts)
            if led >= 0 and instant_ns <= self._now_ns - self._soonest_ns - _TIMEOUT_NS
        ]

    def _note_first(self, events: Sequence[SensedEvent]) -> None:
        if self._first_ns is None and events:
            self._first_ns = events[0].instant_ns

    def report(self, senses: Sequence[str]) -> SyncReport | None:
        """The section `sync` of a report; None if nothing was touched.

        senses: those that contacts reach; findings of other senses are left out.
        """
        events = self._events(senses)
        self._note_first(events)
        if self._first_ns is None:
            return None
        start_ns = self._first_ns
        tally = _Tally(self._settled)
        tally.add(events)
        contacts, bounces = self._apart()
        return SyncReport(
            events=tally.events,
            touches_beside_targets=self._settled_beside + sum(led < 0 for _, led in contacts),
            bounces=self._settled_bounces + bounces,
            senses={
                sense: self._sense(sense, events, tally) if sense in senses else None
                for sense in SENSES
            },
            skew_ms={
                pair: skew_summary(
                    pair, tally.durations["skew", pair] if {*both} <= {*senses} else ()
                )
                for pair, both in PAIRS.items()
            },
            listed=[_listed(event, start_ns) for event in events[-_LISTED:]],
        )

    def _apart(self) -> tuple[list[tuple[int, int]], int]:
        apart: list[tuple[int, int]] = []
        bounces, last_ns = 0, -(1 << 62)
        for instant_ns, led in sorted(self._contacts):
            if instant_ns - last_ns < _BOUNCE_NS:
                bounces += 1
            else:
                apart.append((instant_ns, led))
            last_ns = instant_ns
        return apart, bounces

    def _sorted(self, sense: str) -> list[Matched]:
        found = list(self._found[sense])
        if sense == "force":
            # These steps were felt, although the stamps of their samples are not known yet.
            found += map(Matched, self._steps)
        return sorted(found, key=lambda one: one.instant_ns)

    def _sense(self, sense: str, events: Sequence[SensedEvent], tally: _Tally) -> SenseReport:
        verdict = judge(
            [
                (event.instant_ns, found)
                for event in events
                if (found := event.perceived[sense]) is not None
            ]
        )
        perceived = tally.durations["latency", sense].total()
        return SenseReport(
            stream=SENSES[sense],
            perceived=perceived,
            missed=tally.events - perceived,
            latency_ms=ranks_ms(tally.durations["latency", sense]),
            stamped_latency_ms=ranks_ms(tally.durations["stamped", sense]),
            stamp_error_ms=ranks_ms(tally.durations["error", sense]),
            judged=verdict.judged,
            judged_error_ms=None if verdict.median_ns is None else _ms(verdict.median_ns),
            confident_ms=None if verdict.between_ns is None else _both_ms(verdict.between_ns),
            allowed_error_ms=_both_ms(verdict.allowed_ns),
            agrees=verdict.agrees,
            found=self._count[sense] + (len(self._steps) if sense == "force" else 0),
        )


def disagreements(report: SyncReport | None, *, unjudged: Container[str] = ()) -> list[str]:
    """A line for each sense whose stamps contradict its content.

    unjudged: streams that carried something else than the scene's content.
    """
    lines = []
    for sense, metrics in ({} if report is None else report.senses).items():
        if metrics is None or metrics.stream in unjudged:
            continue
        if metrics.agrees is False:
            assert metrics.confident_ms is not None
            least, most = metrics.allowed_error_ms
            low, high = metrics.confident_ms
            lines.append(
                f"{metrics.stream}: stamps and content disagree: by its stamps a {sense} was "
                f"captured {metrics.judged_error_ms:+.1f} ms after the contact that made it "
                f"({least:+.1f} to {most:+.1f} are allowed; median of {metrics.judged}, "
                f"{low:+.1f} to {high:+.1f} with 95 % confidence)"
            )
    return lines


def skews_ns(pair: str, events: Sequence[SensedEvent]) -> list[int]:
    """How much later (ns) the pair's first sense came than its second, if both came."""
    first, second = PAIRS[pair]
    both = ((event.latency_ns(first), event.latency_ns(second)) for event in events)
    return [a - b for a, b in both if a is not None and b is not None]


def skew_summary(pair: str, values_ns: Iterable[int]) -> ContentSkew | None:
    """Percentiles of a pair's skews, and the share that goes unnoticed; None without any.

    values_ns: the skews, or a Counter of how often each came.
    """
    counted = Counter(values_ns)
    if not counted:
        return None
    limit = LIMITS[pair]
    within = sum(count for value_ns, count in counted.items() if limit.holds(value_ns))
    return ContentSkew(
        events=counted.total(),
        **summary_ms(counted),
        within=round(within / counted.total(), 4),
        limits_ms=(limit.least_ns / NS_PER_MS, limit.most_ns / NS_PER_MS),
        source=limit.source,
    )


def ranks_ms(counted: Counter[int]) -> Ranks:
    return Ranks(**summary_ms(counted))


def summary_ms(counted: Counter[int]) -> dict[str, float]:
    """p50, p95, p99 of signed values by nearest rank, and the one farthest from zero, in ms."""
    if not counted:
        return {}
    ordered = sorted(counted)
    ends = list(accumulate(counted[value] for value in ordered))
    metrics = {f"p{p}": ordered[bisect_left(ends, rank_of(p, ends[-1]))] for p in (50, 95, 99)}
    metrics["max"] = max(ordered, key=abs)
    return {name: _ms(value) for name, value in metrics.items()}


def _ms(value_ns: int) -> float:
    return round(value_ns / NS_PER_MS, 3)


def _both_ms(values_ns: tuple[int, int]) -> tuple[float, float]:
    return _ms(values_ns[0]), _ms(values_ns[1])


def _listed(event: SensedEvent, start_ns: int) -> ListedContact:
    latencies_ns = {f"{sense}_ms": event.latency_ns(sense) for sense in SENSES}
    return ListedContact(
        at_s=round((event.instant_ns - start_ns) / NS_PER_S, 4),
        led=event.led,
        **{name: None if value is None else _ms(value) for name, value in latencies_ns.items()},
    )


@dataclass(frozen=True, kw_only=True)
class Limit:
    """The first sense may come from `least_ns` to `most_ns` after the second one."""

    least_ns: int
    most_ns: int
    source: str

    def holds(self, skew_ns: int) -> bool:
        """Whether a skew, positive if the first sense is late, goes unnoticed."""
        return self.least_ns <= skew_ns <= self.most_ns


#: By the names of the skews in the report.
LIMITS = {
    # Touch up to 50 ms after sight, but only 15 ms before it.
    "video_haptic": Limit(
        least_ns=-50 * NS_PER_MS,
        most_ns=15 * NS_PER_MS,
        source="Di Luca and Mahnan, World Haptics 2019",
    ),
    "audio_haptic": Limit(
        least_ns=-24 * NS_PER_MS, most_ns=24 * NS_PER_MS, source="Adelstein et al., 2003"
    ),
    "audio_video": Limit(least_ns=-EARLIEST_NS, most_ns=LATEST_NS, source="ITU-R BT.1359"),
}


def sync_section(setup: Setup, metrics: SyncMetrics, *, media: bool) -> SyncReport | None:
    """Contacts, and when they were seen, heard and felt; None if nothing was touched.

    media: False if the session had no streams, whatever its setup says.
    """
    carried = {"haptic_up", *(stream.name for stream in setup.streams if media)}
    senses = [
        sense
        for sense, stream in SENSES.items()
        if stream in carried and _touch_reaches(setup, sense)
    ]
    return metrics.report(senses)


def _touch_reaches(setup: Setup, sense: str) -> bool:
    """Whether the operator sees, hears or feels the place where the simulated stylus touches.

    A flash in a film, or a click at the user's own microphone, is no contact.
    """
    if sense == "force" and setup.force == "none":
        return False
    inputs = {"light": setup.camera_inputs, "click": (GROUND_MIC,)}.get(sense, ())
    return all(setup.source(name) in CONTACT_SCENES for name in inputs)
