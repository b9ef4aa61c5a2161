"""A session of a campaign, its figures and those of its tasks, and the verdict. A core."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from statistics import median
from typing import Any

from kontur_av.clock import NS_PER_S
from pipelines.report.model import (
    GatewayReport,
    HapticReport,
    SessionReport,
    StreamReport,
    to_builtins,
)
from pipelines.session.setup.table import Setup
from pipelines.session.task_journal import OPEN, STEPS, TaskRow
from telepresence.link.link_metrics import ContactMetrics
from telepresence.tasks.definitions import Catalogue
from telepresence.tasks.experiment import RunStep
from telepresence.tasks.plan import SessionPlan
from telepresence.tmtc.k2aci import TaskResult


@dataclass(frozen=True, kw_only=True)
class SessionTask:
    """A session on virtual time, whole: no file is needed to run it, but those of its sources.

    seconds: of virtual time. media: False leaves haptics and telecommands alone. plan: as of
    `pipelines.virtual.simulate.simulate`.
    """

    setup: Setup
    seconds: float
    seed: int
    media: bool = True
    plan: tuple[SessionPlan, Catalogue] | None = None


@dataclass(frozen=True, slots=True)
class Crash:
    """A session without a report. error: its last words."""

    error: str


#: What became of a session: its report, or none.
Result = SessionReport | Crash


#: The least share of the usable time that the orbit predicts.
USABLE_SHARE = 0.99
#: A stream that shows nothing, or a channel that moves no sample, is stuck after this time with a
#: signal in the predicted window.
LONGEST_PAUSE_S = {"shown": 3.0, "felt": 1.0}
#: One-way delays that a session of samples takes to begin (docs/wire-formats.md).
HAPTIC_BEGIN_DELAYS = 5
#: Rounding down at both ports makes the observed energy too small by this at most (µJ).
ROUNDING_UJ = 2
#: The largest rate over 100 ms in % of the cap (docs/rtp-streams.md).
MOST_BURST_PCT = 150


@dataclass(frozen=True, slots=True, kw_only=True)
class PassMetrics:
    """What a session is judged by.

    predicted_s, usable_s: the time that the orbit predicts as usable, and what of it had a signal;
    None where the radio has no contact. longest_delay_s: of the radio. longest_pause_s: with a
    signal, as `LONGEST_PAUSE_S`. cap_pct, burst_pct: the largest rate over 1 s and over 100 ms in %
    of a stream's cap. least_energy_uj: the least that a passivity observer saw.
    """

    seconds: float
    predicted_s: float | None
    usable_s: float | None
    longest_delay_s: float
    longest_pause_s: Mapping[str, float]
    cap_pct: float | None
    burst_pct: float | None
    least_energy_uj: float | None
    failed: bool


def pass_metrics(report: SessionReport, *, start_s: float = 0.0) -> PassMetrics:
    """The figures of a session.

    start_s: when the session began, after the acquisition of signal.
    """
    window, radio = usable_window(report, start_s), report.gateways["ground"].radio
    return PassMetrics(
        seconds=report.seconds,
        predicted_s=None if window is None else round(window[1] - window[0], 3),
        usable_s=None if window is None else round(signal_s(report, *window), 3),
        longest_delay_s=0.0 if radio is None else radio.delay_max_ns / NS_PER_S,
        longest_pause_s={
            "shown": _longest_pause_s(report, report.streams, window),
            "felt": _longest_pause_s(report, report.haptic, window),
        },
        cap_pct=cap_pct(report, "1s"),
        burst_pct=cap_pct(report, "100ms"),
        least_energy_uj=least_energy_uj(report),
        failed=bool(report.failures),
    )


def cap_pct(report: SessionReport, over: str) -> float | None:
    """The largest rate of any stream over "1s" or "100ms" in % of its cap."""
    shares = (
        round(getattr(stream, f"payload_bps_max_{over}") / stream.cap_bps, 4)
        for stream in report.streams.values()
    )
    return max((100.0 * share for share in shares), default=None)


def usable_window(report: SessionReport, start_s: float) -> tuple[float, float] | None:
    """Begin and end (s) of the usable contact in the session, as the orbit predicts it.

    The whole session where the radio has no orbit; None where the session misses the contact.
    """
    contact = report.gateways["ground"].contact
    if contact is None:
        return 0.0, report.seconds
    if contact.usable_from_s is None or contact.usable_to_s is None:
        return None
    begin_s = max(0.0, contact.usable_from_s - start_s)
    end_s = min(report.seconds, contact.usable_to_s - start_s)
    return (begin_s, end_s) if end_s > begin_s else None


def signal_s(report: SessionReport, begin_s: float, end_s: float) -> float:
    """The time (s) between two instants in which an end had a signal, at the end that had less."""
    heard = []
    for gateway in report.gateways.values():
        total_ns = 0.0
        for contact in _contacts(gateway):
            lost_ns, last_ns = contact.lost_ns, end_s * NS_PER_S
            last_ns = last_ns if lost_ns is None else min(lost_ns, last_ns)
            total_ns += max(0, last_ns - max(contact.acquired_ns, begin_s * NS_PER_S))
        heard.append(total_ns / NS_PER_S)
    return min(heard, default=0.0)


def _contacts(gateway: GatewayReport) -> Sequence[ContactMetrics]:
    return () if gateway.supervision is None else gateway.supervision.contacts


def _longest_pause_s(
    report: SessionReport,
    channels: Mapping[str, StreamReport] | Mapping[str, HapticReport],
    window: tuple[float, float] | None,
) -> float:
    """The longest part of a pause of one of `channels` with a signal throughout, in the window."""
    if window is None:
        return 0.0
    longest_s = 0.0
    for name, channel in channels.items():
        # The signal at the receiving end counts.
        contacts = _contacts(report.gateways["space" if name.startswith("up") else "ground"])
        for begin_s, end_s in channel.pauses_s:
            for contact in contacts:
                lost_ns = contact.lost_ns
                last_s = report.seconds if lost_ns is None else lost_ns / NS_PER_S
                first_s = max(begin_s, contact.acquired_ns / NS_PER_S, window[0])
                longest_s = max(longest_s, min(end_s, last_s, window[1]) - first_s)
    return round(longest_s, 3)


def least_energy_uj(report: SessionReport) -> float | None:
    """The least energy (µJ) that a passivity observer has seen; None if there is none."""
    ports = [
        port for way in report.haptic.values() for port in (way.port, *(way.axes or {}).values())
    ]
    ports += [] if report.second_arm is None else [report.second_arm.port]
    return min((port.least_uj for port in ports), default=None)


def faults(session: PassMetrics | Crash) -> list[str]:
    """What is wrong with a session, one word each; an empty list means a usable pass."""
    if isinstance(session, Crash):
        return ["crashed"]
    found = []
    predicted_s, usable_s = session.predicted_s, session.usable_s
    # The acquisition of signal takes a while at the beginning, with the radio's delay.
    acquired_s = 0.1 + session.longest_delay_s if predicted_s == session.seconds else 0.0
    if (
        predicted_s is None
        or usable_s is None
        or usable_s < USABLE_SHARE * predicted_s - acquired_s
    ):
        found.append("unusable")
    pauses = session.longest_pause_s
    felt_s = LONGEST_PAUSE_S["felt"] + HAPTIC_BEGIN_DELAYS * session.longest_delay_s
    if pauses["shown"] > LONGEST_PAUSE_S["shown"] or pauses["felt"] > felt_s:
        found.append("stuck")
    if session.least_energy_uj is not None and session.least_energy_uj < -ROUNDING_UJ:
        found.append("unstable")
    if (session.cap_pct or 0) > 100 or (session.burst_pct or 0) > MOST_BURST_PCT:
        found.append("over its cap")
    if session.failed:
        found.append("failed")
    return found


#: A run that is not over this long (s) after the last loss of signal is left hanging.
LONGEST_END_S = 30.0
_TOLD_END = STEPS.index(RunStep.FINISHED.value)
#: What the panel reports.
_PANEL = {
    STEPS.index(step.value)
    for step in (RunStep.SHOWN, RunStep.AT_START, RunStep.HELD, RunStep.SEEN)
}


def _quiet_s(report: SessionReport) -> float:
    """From the ground's last loss of signal to the end of the session; 0 with a signal at it."""
    contacts = _contacts(report.gateways["ground"])
    lost_ns = [contact.lost_ns for contact in contacts if contact.lost_ns is not None]
    if not contacts or len(lost_ns) < len(contacts):
        return 0.0
    return max(0.0, report.seconds - max(lost_ns) / NS_PER_S)


def in_order(run: TaskRow) -> bool:
    """Whether each step of Fig. 14 is logged once, in its order, and none left out if finished.

    The panel hears and is heard only with a signal. So if a run ended without one, the panel's
    steps may come after its end, in their own order.
    """
    places = [STEPS.index(step.step) for step in run.steps]
    if run.result == TaskResult.FINISHED:
        whole = list(range(_TOLD_END + 1))
        return places == sorted(set(places)) and places[: _TOLD_END + 1] == whole
    panel = [place for place in places if place in _PANEL]
    robot = [place for place in places if place not in _PANEL]
    return all(part == sorted(set(part)) for part in (panel, robot))


def task_faults(report: SessionReport) -> list[str]:
    found, runs = [], report.tasks or ()
    if not any(run.result == TaskResult.FINISHED for run in runs):
        found.append("no task finished")
    if not all(map(in_order, runs)):
        found.append("out of order")
    if _quiet_s(report) > LONGEST_END_S and any(run.result == OPEN for run in runs):
        found.append("left hanging")
    return found


def task_names(plan: SessionPlan | None) -> tuple[str, ...]:
    """The names of figures that a session with this plan has more than others."""
    if plan is None:
        return ()
    names = dict.fromkeys(planned.name for planned in plan.tasks)
    return ("tasks_begun", "tasks_finished", *(f"{name}_s" for name in names))


def task_numbers(report: SessionReport) -> dict[str, float | None]:
    """The figures of `task_names`: of a task the median time of its finished runs."""
    took_s: dict[str, list[float]] = {}
    for run in report.tasks or ():
        if run.result == TaskResult.FINISHED and run.seconds is not None:
            took_s.setdefault(f"{run.name}_s", []).append(run.seconds)
    return {
        "tasks_begun": len(report.tasks or ()),
        "tasks_finished": sum(map(len, took_s.values())),
        **{name: median(times_s) for name, times_s in took_s.items()},
    }


@dataclass(frozen=True, slots=True)
class SweepFigure:
    """One figure: its name with its unit, the heading of its column, and where it comes from."""

    name: str
    heading: str
    of: Callable[[SessionReport], float | None]


def _latency(channel: StreamReport | HapticReport | None, percentile: str = "p99") -> float | None:
    """None for what carried nothing."""
    if channel is None or not channel.latency_ms.count:
        return None
    found: float = getattr(channel.latency_ms, percentile)
    return found


def _lost(report: SessionReport, direction: str) -> float | None:
    link = report.link[direction]
    frames = link.sender.frames
    return 100.0 * link.receiver.frames_lost / frames if frames else None


def _shown_hz(report: SessionReport) -> float | None:
    """Pictures a second with a signal, at the end that had less of it."""
    ends = [of.supervision for of in report.gateways.values() if of.supervision is not None]
    contact_ns = min((of.contact_ns for of in ends), default=0)
    stream = report.streams.get(VIDEO)
    if stream is None or not contact_ns:
        return None
    return stream.display.frames_displayed / (contact_ns / NS_PER_S)


def _skew_p95(report: SessionReport) -> float | None:
    skew = report.skew_ms.get("video_haptic")
    return None if skew is None else skew.p95


VIDEO, VOICE = "uplink_video", "uplink_voice"
#: In the order of the table. lost: of all frames. skew: the picture after the force. cap: the
#: largest second of any stream, as a share of its cap.
METRICS = (
    SweepFigure("lost_up_pct", "lost up %", lambda of: _lost(of, "uplink")),
    SweepFigure("lost_down_pct", "lost down %", lambda of: _lost(of, "downlink")),
    SweepFigure("force_p99_ms", "force p99 ms", lambda of: _latency(of.haptic["up"])),
    SweepFigure(
        "position_p99_ms", "position p99 ms", lambda of: _latency(of.haptic["down"], "p99")
    ),
    SweepFigure("video_p50_ms", "video p50 ms", lambda of: _latency(of.streams.get(VIDEO), "p50")),
    SweepFigure("video_p99_ms", "video p99 ms", lambda of: _latency(of.streams.get(VIDEO))),
    SweepFigure("shown_hz", "shown/s", _shown_hz),
    SweepFigure("voice_p99_ms", "voice p99 ms", lambda of: _latency(of.streams.get(VOICE))),
    SweepFigure("skew_p95_ms", "skew p95 ms", _skew_p95),
    SweepFigure("cap_pct", "cap %", lambda of: cap_pct(of, "1s")),
    SweepFigure("least_uj", "least µJ", least_energy_uj),
)


HEADINGS = {figure.name: figure.heading for figure in METRICS}


@dataclass(frozen=True, kw_only=True)
class RunMetrics:
    """One run. key: a digest of what was run. faults: of the pass and of its tasks; none: usable.

    metrics: by name; None for what this run does not have. error: the last words of a run that gave
    no report.
    """

    key: str
    seed: int
    faults: tuple[str, ...] = ()
    metrics: Mapping[str, float | None]
    error: str = ""


def run_metrics(
    task: SessionTask, key: str, report: SessionReport, keys: Sequence[str]
) -> RunMetrics:
    """The figures of the run of `task`. keys: of further numbers in the report, with dots."""
    metrics = {figure.name: _rounded(figure.of(report)) for figure in METRICS}
    wrong = faults(pass_metrics(report, start_s=task.setup.radio_profile.start_s))
    if task.plan is not None:
        wrong += task_faults(report)
        metrics |= {name: _rounded(value) for name, value in task_numbers(report).items()}
    table = to_builtins(report) if keys else {}
    metrics |= {name: _number(table, name) for name in keys}
    return RunMetrics(key=key, seed=task.seed, faults=tuple(wrong), metrics=metrics)


def crashed(task: SessionTask, key: str, crash: Crash) -> RunMetrics:
    return RunMetrics(
        key=key, seed=task.seed, faults=tuple(faults(crash)), metrics={}, error=crash.error
    )


def _rounded(value: float | None) -> float | None:
    return None if value is None else round(value, 3)


def _number(table: Any, key: str) -> float | None:
    """The number under keys with dots between them; None if there is none."""
    for part in key.split("."):
        if not isinstance(table, Mapping) or part not in table:
            return None
        table = table[part]
    return table if isinstance(table, int | float) and not isinstance(table, bool) else None
