"""An account of a session to look at: a report as one HTML file, which needs nothing beside it."""

from collections.abc import Iterator, Sequence
from html import escape

from kontur_av.clock import NS_PER_S
from pipelines.report.html_page import Bar, section, table, track, whole_page
from pipelines.report.model import ContentSkew, SessionReport, SkewReport, Spread
from pipelines.report.summary import first_line, task_line
from pipelines.session.task_journal import TaskRow

_WIDE = 10_000
_STAGES = {
    "capture_to_encoded": "capture and encoding",
    "encoded_to_sent": "pacing",
    "sent_to_received": "link",
    "received_to_displayed": "decoding and playout",
}


def account_of(report: SessionReport) -> str:
    """The whole page: what fell short, the story, latency, rates, skew and tasks, in words too."""
    title = f"Session {report.setup}, {report.seconds:.1f} s"
    line = " · ".join(first_line(report, _WIDE).split("  "))
    happened = events_of(report)
    parts = [
        f"<h1>{escape(title)}</h1><p>{escape(line)}</p>",
        *section("What fell short", _shortcomings(report)),
        *section("What happened, over the time of the session", _times(report)),
        *section("Events", table(("s", "what"), ((f"{s:.1f}", what) for s, what in happened))),
        *section("Latency, ms", _latencies(report)),
        *section("Rates, as parts of their caps", _rates(report)),
        *section("Skew, ms", table(("first to second", "p50", "p95", "p99"), _skews(report))),
        *section("Tasks", _tasks(report.tasks or ())),
    ]
    return whole_page(title, parts)


def _shortcomings(report: SessionReport) -> Iterator[str]:
    if not report.failures:
        yield "<p>Nothing failed.</p>"
    for failure in report.failures:
        yield f'<p class="failed">failed: {escape(failure)}</p>'
    yield from table(
        ("where", "measured", "fix"),
        ((warning.where, warning.measured, warning.fix) for warning in report.warnings),
    )


def _times(report: SessionReport) -> Iterator[str]:
    whole = max(report.seconds, 1e-9)
    for end, gateway in report.gateways.items():
        if (supervision := gateway.supervision) is None:
            continue
        bars = []
        for contact in supervision.contacts:
            ended_s = whole if contact.lost_ns is None else contact.lost_ns / NS_PER_S
            bars.append(Bar(contact.acquired_ns / NS_PER_S, ended_s, "good", "signal"))
        contact_s = sum(bar.end - bar.begin for bar in bars)
        words = f"{contact_s:.1f} of {whole:.1f} s, acquired {_times_of(bars)}"
        yield track(f"signal, {end}", bars, whole, words)
    pauses = {name: stream.pauses_s for name, stream in report.streams.items()}
    pauses.update((f"haptic_{name}", haptic.pauses_s) for name, haptic in report.haptic.items())
    for name, spans in pauses.items():
        # What received nothing to the end has no pause.
        bars = [
            Bar(begin, end, "bad", f"pause from {begin:.1f} to {end:.1f} s") for begin, end in spans
        ]
        silent_s = sum(end - begin for begin, end in spans)
        words = f"paused {silent_s:.1f} s, {_times_of(spans)}" if spans else "no pause"
        yield track(name, bars, whole, words)
    for run in report.tasks or ():
        begin_s, end_s = run.selected_ns / NS_PER_S, _ended_s(run)
        bars = [Bar(begin_s, end_s, "run", task_line(run))]
        yield track(
            f"{run.name}, run {run.run}",
            bars,
            whole,
            f"{run.result.replace('_', ' ')}, {begin_s:.1f} to {end_s:.1f} s",
        )
    if report.stopped_s:
        bars = [Bar(begin, end, "bad", "stopped") for begin, end in report.stopped_s]
        yield track("stopped on request", bars, whole, _times_of(bars))


def _times_of(found: Sequence[object]) -> str:
    return "once" if len(found) == 1 else f"{len(found)} times"


def _ended_s(run: TaskRow) -> float:
    return max([run.selected_ns, *(step.at_ns for step in run.steps)]) / NS_PER_S


def events_of(report: SessionReport) -> list[tuple[float, str]]:
    """What happened, in its order: seconds since the start, and words."""
    return sorted(_dated(report), key=lambda event: event[0])


def _dated(report: SessionReport) -> Iterator[tuple[float, str]]:
    """What has an instant: seconds, and words."""
    for end, gateway in report.gateways.items():
        for contact in gateway.supervision.contacts if gateway.supervision else ():
            instants_ns = {
                "signal acquired": contact.acquired_ns,
                "link connected": contact.connected_ns,
                "signal lost": contact.lost_ns,
            }
            for words, at_ns in instants_ns.items():
                if at_ns is not None:
                    yield at_ns / NS_PER_S, f"{end}: {words}"
    for run in report.tasks or ():
        for step in run.steps:
            yield step.at_ns / NS_PER_S, f"{run.name}, run {run.run}: {step.step}"
        yield _ended_s(run), task_line(run)
    for exercise in report.exercises or ():
        yield exercise.at_ns / NS_PER_S, f"trainer: {exercise.what}"
    for owner in report.arm.events if report.arm else ():
        yield owner.at_ns / NS_PER_S, f"arm: {owner.what}"
    for begin_s, end_s in report.stopped_s or ():
        yield begin_s, "the session was stopped"
        yield end_s, "the session was started"


def _latencies(report: SessionReport) -> Iterator[str]:
    spreads: dict[str, Spread] = {name: row.latency_ms for name, row in report.streams.items()}
    spreads.update((f"haptic_{name}", row.latency_ms) for name, row in report.haptic.items())
    counted = {name: spread for name, spread in spreads.items() if spread.count}
    if not counted:
        return
    keys = (f'<span><b class="s{k}"></b>{words}</span>' for k, words in enumerate(_STAGES.values()))
    yield f'<p class="key">{"".join(keys)}<span>lines: p50, p95, p99</span></p>'
    most = max(spread.p99 for spread in counted.values()) or 1.0
    for name, spread in counted.items():
        bars, begin = [], 0.0
        for number, (words, mean_ms) in enumerate(_stages(report, name)):
            bars.append(Bar(begin, begin + mean_ms, f"s{number}", f"{words} {mean_ms:.1f} ms"))
            begin += mean_ms
        ranks = {"p50": spread.p50, "p95": spread.p95, "p99": spread.p99}
        bars += [Bar(ms, ms, "mark", f"{rank} {ms:.1f} ms") for rank, ms in ranks.items()]
        said = ", ".join(f"{rank} {ms:.1f}" for rank, ms in ranks.items())
        yield track(name, bars, most, f"{said}, largest {spread.max:.1f}")


def _stages(report: SessionReport, name: str) -> Iterator[tuple[str, float]]:
    """The stages of a stream and their means in ms; the link alone for haptics."""
    if name in report.streams:
        stages = report.streams[name].latency_ms.stages
        for field, words in _STAGES.items():
            yield words, getattr(stages, field).mean
    else:
        yield from ((words, 0.0) for words in [*_STAGES.values()][:2])
        yield "link", report.haptic[name.removeprefix("haptic_")].latency_ms.mean


def _rates(report: SessionReport) -> Iterator[str]:
    for name, stream in report.streams.items():
        if stream.side == "receiver":
            continue
        most_bps = max(stream.cap_bps, stream.payload_bps_max_1s, 1)
        look = "good" if stream.payload_bps_max_1s <= stream.cap_bps else "bad"
        words = (
            f"{stream.payload_bps_mean / 1000:.1f} kbit/s, largest second "
            f"{stream.payload_bps_max_1s / 1000:.1f}, cap {stream.cap_bps / 1000:.0f}"
        )
        bars = [Bar(0.0, stream.payload_bps_mean, look, words)]
        for title, bps in (("largest second", stream.payload_bps_max_1s), ("cap", stream.cap_bps)):
            bars.append(Bar(bps, bps, "mark", f"{title} {bps / 1000:.1f} kbit/s"))
        yield track(name, bars, most_bps, words)


def _skews(report: SessionReport) -> Iterator[tuple[str, ...]]:
    found: dict[str, SkewReport | ContentSkew | None] = {**report.skew_ms}
    if report.sync is not None:
        found.update((f"{name}, by content", skew) for name, skew in report.sync.skew_ms.items())
    for name, skew in found.items():
        if skew is not None:
            ranks = skew.p50, skew.p95, skew.p99
            yield name.replace("_", " to "), *(f"{value:+.1f}" for value in ranks)


def _tasks(runs: Sequence[TaskRow]) -> Iterator[str]:
    most_n = max([1.0, *(run.force_max_n for run in runs)])
    for run in runs:
        words = (
            f"{run.result.replace('_', ' ')}{f': {run.reason}' if run.reason else ''}; way "
            f"{1000 * run.path_m:.0f} mm, force {run.force_mean_n:.1f} N, at most "
            f"{run.force_max_n:.1f} N"
        )
        bars = [Bar(0.0, run.force_mean_n, "run", "mean force")]
        bars.append(Bar(run.force_max_n, run.force_max_n, "mark", "largest force"))
        yield track(f"{run.name}, run {run.run}", bars, most_n, words)
