"""A session of a campaign, its figures and those of its tasks, and the verdict. A core."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from statistics import median

from kontur_av.clock import NS_PER_S
from pipelines.report.result import JsonReader
from pipelines.session.setup.table import Setup
from pipelines.session.task_journal import OPEN, STEPS
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
Result = JsonReader | Crash


#: The least share of the usable time that the orbit predicts.
USABLE_SHARE = 0.99
#: A stream that shows nothing, or a channel that moves no sample, is stuck after this time with a
#: signal in the predicted window.
LONGEST_PAUSE_S = {"shown": 3.0, "felt": 1.0}
#: One-way delays that a session of samples takes to begin (docs/haptics-sample.md).
HAPTIC_BEGIN_DELAYS = 5
#: Rounding down at both ports makes the observed energy too small by this at most (µJ).
ROUNDING_UJ = 2
#: The largest rate over 100 ms in % of the cap (docs/video.md).
MOST_BURST_PCT = 150


@dataclass(frozen=True, slots=True, kw_only=True)
class PassFigures:
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


def pass_figures(report: JsonReader, *, start_s: float = 0.0) -> PassFigures:
    """The figures of a session.

    start_s: when the session began, after the acquisition of signal.
    """
    window = usable_window(report, start_s)
    delay_ns = report.at("gateways", "ground").number_or_none("radio", "delay_max_ns")
    return PassFigures(
        seconds=report.number("seconds"),
        predicted_s=None if window is None else round(window[1] - window[0], 3),
        usable_s=None if window is None else round(signal_s(report, *window), 3),
        longest_delay_s=(delay_ns or 0) / NS_PER_S,
        longest_pause_s={
            name: _longest_pause_s(report, channels, window)
            for name, channels in (("shown", "streams"), ("felt", "haptic"))
        },
        cap_pct=cap_pct(report, "1s"),
        burst_pct=cap_pct(report, "100ms"),
        least_energy_uj=least_energy_uj(report),
        failed=any(True for _ in report.elements("failures")),
    )


def cap_pct(report: JsonReader, over: str) -> float | None:
    """The largest rate of any stream over "1s" or "100ms" in % of its cap."""
    shares = (
        round(stream.number(f"payload_bps_max_{over}") / stream.number("cap_bps"), 4)
        for _, stream in report.items("streams")
    )
    return max((100.0 * share for share in shares), default=None)


def usable_window(report: JsonReader, start_s: float) -> tuple[float, float] | None:
    """Begin and end (s) of the usable contact in the session, as the orbit predicts it.

    The whole session where the radio has no orbit; None where the session misses the contact.
    """
    ground, seconds = report.at("gateways", "ground"), report.number("seconds")
    if not ground.has("radio", "contact"):
        return 0.0, seconds
    contact = ground.at("radio", "contact")
    begin_s = max(0.0, contact.number("usable_from_s") - start_s)
    end_s = min(seconds, contact.number("usable_to_s") - start_s)
    return (begin_s, end_s) if end_s > begin_s else None


def signal_s(report: JsonReader, begin_s: float, end_s: float) -> float:
    """The time (s) between two instants in which an end had a signal, at the end that had less."""
    heard = []
    for _, gateway in report.items("gateways"):
        total_ns = 0.0
        for acquired_ns, lost_ns in _windows_ns(gateway):
            last_ns = end_s * NS_PER_S if lost_ns is None else min(lost_ns, end_s * NS_PER_S)
            total_ns += max(0, last_ns - max(acquired_ns, begin_s * NS_PER_S))
        heard.append(total_ns / NS_PER_S)
    return min(heard, default=0.0)


def _windows_ns(gateway: JsonReader) -> Iterator[tuple[float, float | None]]:
    """(acquisition, loss) of each contact of one end; None for one that lasts."""
    if gateway.has("supervision", "contacts"):
        for window in gateway.elements("supervision", "contacts"):
            yield window.number("acquired_ns"), window.number_or_none("lost_ns")


def _longest_pause_s(
    report: JsonReader, channels: str, window: tuple[float, float] | None
) -> float:
    """The longest part of a pause of one of `channels` with a signal throughout, in the window."""
    if window is None:
        return 0.0
    longest_s = 0.0
    for name, channel in report.items(channels):
        # The signal at the receiving end counts.
        end = "space" if name.startswith("up") else "ground"
        contacts = list(_windows_ns(report.at("gateways", end)))
        for pause in channel.elements("pauses_s"):
            begin_s, end_s = (instant.number() for instant in pause.elements())
            for acquired_ns, lost_ns in contacts:
                last_s = report.number("seconds") if lost_ns is None else lost_ns / NS_PER_S
                first_s = max(begin_s, acquired_ns / NS_PER_S, window[0])
                longest_s = max(longest_s, min(end_s, last_s, window[1]) - first_s)
    return round(longest_s, 3)


def least_energy_uj(report: JsonReader) -> float | None:
    """The least energy (µJ) that a passivity observer has seen; None if there is none."""
    places = (report.at(name) for name in ("haptic", "processes") if report.has(name))
    return min((least for place in places for least in _values("least_uj", place)), default=None)


def _values(name: str, table: JsonReader) -> Iterator[float]:
    for key, part in table.items():
        if isinstance(part.value, Mapping):
            yield from _values(name, part)
        elif key == name and part.value is not None:
            yield part.number()


def faults(session: PassFigures | Crash) -> list[str]:
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


@dataclass(frozen=True, kw_only=True, slots=True)
class Run:
    """One run of a task. seconds: from its start to its end; None if it never started."""

    name: str
    result: str
    seconds: float | None
    steps: list[str]


@dataclass(frozen=True, kw_only=True, slots=True)
class TaskRunFigures:
    """What was done in one session.

    quiet_s: from the ground's last loss of signal to the end of the session, 0 if there was a
    signal at the end.
    """

    runs: list[Run]
    quiet_s: float


def task_figures(report: JsonReader) -> TaskRunFigures:
    return TaskRunFigures(
        runs=[
            Run(
                name=run.text("name"),
                result=run.text("result"),
                seconds=run.number_or_none("seconds"),
                steps=[step.text("step") for step in run.elements("steps")],
            )
            for run in report.elements("tasks")
        ],
        quiet_s=_quiet_s(report),
    )


def _quiet_s(report: JsonReader) -> float:
    ground, seconds = report.at("gateways", "ground"), report.number("seconds")
    if not ground.has("supervision", "contacts"):
        return 0.0
    lost_s = 0.0
    for window in ground.elements("supervision", "contacts"):
        lost_ns = window.number_or_none("lost_ns")
        if lost_ns is None:
            return 0.0
        lost_s = max(lost_s, lost_ns / NS_PER_S)
    return max(0.0, seconds - lost_s)


def in_order(run: Run) -> bool:
    """Whether each step of Fig. 14 is logged once, in its order, and none left out if finished.

    The panel hears and is heard only with a signal. So if a run ended without one, the panel's
    steps may come after its end, in their own order.
    """
    places = [STEPS.index(step) for step in run.steps]
    if run.result == TaskResult.FINISHED:
        whole = list(range(_TOLD_END + 1))
        return places == sorted(set(places)) and places[: _TOLD_END + 1] == whole
    panel = [place for place in places if place in _PANEL]
    robot = [place for place in places if place not in _PANEL]
    return all(part == sorted(set(part)) for part in (panel, robot))


def task_faults(tasks: TaskRunFigures) -> list[str]:
    found = []
    if not any(run.result == TaskResult.FINISHED for run in tasks.runs):
        found.append("no task finished")
    if not all(map(in_order, tasks.runs)):
        found.append("out of order")
    if tasks.quiet_s > LONGEST_END_S and any(run.result == OPEN for run in tasks.runs):
        found.append("left hanging")
    return found


def task_names(plan: SessionPlan | None) -> tuple[str, ...]:
    """The names of figures that a session with this plan has more than others."""
    if plan is None:
        return ()
    names = dict.fromkeys(planned.name for planned in plan.tasks)
    return ("tasks_begun", "tasks_finished", *(f"{name}_s" for name in names))


def task_numbers(tasks: TaskRunFigures) -> dict[str, float | None]:
    """The figures of `task_names`: of a task the median time of its finished runs."""
    took_s: dict[str, list[float]] = {}
    for run in tasks.runs:
        if run.result == TaskResult.FINISHED and run.seconds is not None:
            took_s.setdefault(f"{run.name}_s", []).append(run.seconds)
    return {
        "tasks_begun": len(tasks.runs),
        "tasks_finished": sum(map(len, took_s.values())),
        **{name: median(times_s) for name, times_s in took_s.items()},
    }


@dataclass(frozen=True, slots=True)
class SweepFigure:
    """One figure: its name with its unit, the heading of its column, and where it comes from."""

    name: str
    heading: str
    of: Callable[[JsonReader], float | None]


def _latency(percentile: str, *place: str) -> Callable[[JsonReader], float | None]:
    """None for what carried nothing."""

    def found(report: JsonReader) -> float | None:
        carried = report.number_or_none(*place, "latency_ms", "count")
        return report.number(*place, "latency_ms", percentile) if carried else None

    return found


def _lost(number: int) -> Callable[[JsonReader], float | None]:
    def found(report: JsonReader) -> float | None:
        _, link = list(report.items("link"))[number]
        frames = link.count("frames")
        return 100.0 * link.count("frames_lost") / frames if frames else None

    return found


def _shown_hz(report: JsonReader) -> float | None:
    """Pictures a second with a signal, at the end that had less of it."""
    ends = [of for _, of in report.items("gateways") if of.has("supervision")]
    contact_ns = min((of.number("supervision", "contact_ns") for of in ends), default=0.0)
    shown = report.number_or_none("streams", "uplink_video", "frames_displayed")
    return None if shown is None or not contact_ns else shown / (contact_ns / NS_PER_S)


#: In the order of the table. lost: of all frames. skew: the picture after the force. cap: the
#: largest second of any stream, as a share of its cap.
FIGURES = (
    SweepFigure("lost_up_pct", "lost up %", _lost(0)),
    SweepFigure("lost_down_pct", "lost down %", _lost(1)),
    SweepFigure("force_p99_ms", "force p99 ms", _latency("p99", "haptic", "up")),
    SweepFigure("position_p99_ms", "position p99 ms", _latency("p99", "haptic", "down")),
    SweepFigure("video_p50_ms", "video p50 ms", _latency("p50", "streams", "uplink_video")),
    SweepFigure("video_p99_ms", "video p99 ms", _latency("p99", "streams", "uplink_video")),
    SweepFigure("shown_hz", "shown/s", _shown_hz),
    SweepFigure("voice_p99_ms", "voice p99 ms", _latency("p99", "streams", "uplink_voice")),
    SweepFigure(
        "skew_p95_ms", "skew p95 ms", lambda of: of.number_or_none("skew_ms", "video_haptic", "p95")
    ),
    SweepFigure("cap_pct", "cap %", lambda of: cap_pct(of, "1s")),
    SweepFigure("least_uj", "least µJ", least_energy_uj),
)


HEADINGS = {figure.name: figure.heading for figure in FIGURES}


@dataclass(frozen=True, kw_only=True)
class RunFigures:
    """One run. key: a digest of what was run. faults: of the pass and of its tasks; none: usable.

    figures: by name; None for what this run does not have. error: the last words of a run that gave
    no report.
    """

    key: str
    seed: int
    faults: tuple[str, ...] = ()
    figures: Mapping[str, float | None]
    error: str = ""


def run_figures(task: SessionTask, key: str, report: JsonReader, keys: Sequence[str]) -> RunFigures:
    """The figures of the run of `task`. keys: of further numbers in the report, with dots."""
    figures = {figure.name: _rounded(figure.of(report)) for figure in FIGURES}
    wrong = faults(pass_figures(report, start_s=task.setup.radio_profile.start_s))
    if task.plan is not None:
        tasks = task_figures(report)
        wrong += task_faults(tasks)
        figures |= {name: _rounded(value) for name, value in task_numbers(tasks).items()}
    for name in keys:
        figures[name] = _number(report, name)
    return RunFigures(key=key, seed=task.seed, faults=tuple(wrong), figures=figures)


def crashed(task: SessionTask, key: str, crash: Crash) -> RunFigures:
    return RunFigures(
        key=key, seed=task.seed, faults=tuple(faults(crash)), figures={}, error=crash.error
    )


def _rounded(value: float | None) -> float | None:
    return None if value is None else round(value, 3)


def _number(report: JsonReader, key: str) -> float | None:
    try:
        return report.number(*key.split("."))
    except ValueError:
        return None
