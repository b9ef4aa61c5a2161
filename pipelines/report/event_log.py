"""What happened in a session, as lines for people, found by comparing looks at its figures. A core.

Where a figure has its own instant, the event has that one; else that of the look. The lines of one
look are in the order of their instants.
"""

from collections import deque
from collections.abc import Iterator, Sequence

from kontur_av.clock import NS_PER_S, NS_PER_US
from kontur_av.streams.staleness import State
from pipelines.media.marking import age_words
from pipelines.media.media_metrics import SelectorMetrics
from pipelines.mission.mission_metrics import ComponentMetrics, TaskMetrics
from pipelines.report.collector import Collector
from pipelines.report.silence import shown_now, silences
from pipelines.report.upkeep_now import UPKEEP, UpkeepNow
from pipelines.report.warnings import TOO_BUSY
from pipelines.seats.page_metrics import PageMetrics
from pipelines.session.session_metrics import DatedEvent, Event, ProcessNow, TrainerMetrics
from pipelines.session.session_switch import Activity, SessionSwitch
from pipelines.session.setup.segments import Segment
from pipelines.session.task_journal import KEPT, OPEN
from pipelines.session.topology.topics import PAGES, TASKS, TRAINER, component_process
from telepresence.haptics.authority import AuthorityEvent, AuthorityMetrics
from telepresence.haptics.envelope import SafetyMetrics
from telepresence.haptics.haptic_metrics import JoystickMetrics, RobotMetrics
from telepresence.link.link_metrics import PeerMetrics, SupervisionMetrics
from telepresence.tasks.experiment import RunStep

#: How many events are kept.
DEPTH = 200
#: States of the link that are told; those between them last for milliseconds.
_TOLD_STATES = ("connected", "refused")


class EventLog:
    """Finds events, and keeps the newest 200. Call `handle_look` about once a second."""

    def __init__(self, collector: Collector) -> None:
        self.events: deque[Event] = deque(maxlen=DEPTH)
        self.upkeep = UpkeepNow(collector)
        #: What people noted since the last look.
        self._notes: list[tuple[int, str, str]] = []
        self._collector = collector
        #: Of the newest event.
        self.number = 0
        self._running = True
        #: By record: until when it has been told.
        self._told_ns: dict[tuple[str, ...], int] = {}
        #: Run and stage of a task until which they have been told.
        self._task_told = 0, 0
        self._pass_s: float | None = None
        self._camera = collector.setup.cameras[0] if collector.setup.cameras else ""
        self._restarts: dict[str, int] = {}
        #: By process that does not do its work: why, as it was told.
        self._troubled: dict[str, str] = {}
        self._too_busy: set[str] = set()
        self._stale: dict[str, bool] = {}
        self._joystick: tuple[str, str] | None = None
        #: Of the robot.
        self._fault = ""
        self._silent: set[str] = set()
        self._faults: dict[str, str] = {}
        self._live: dict[str, str] = {}

    def handle_look(
        self,
        processes: Sequence[ProcessNow],
        *,
        switch: SessionSwitch,
        started_ns: int,
        now_ns: int,
    ) -> None:
        """Find what happened since the last look. started_ns: when the session began."""
        found = [
            *self._session(switch),
            *self._recorded(),
            *self._tasks(now_ns),
            *self._passes(started_ns, now_ns),
            *self._cameras(),
            *self._restarted(processes, now_ns),
            *self._joysticks(now_ns),
            *self._robots(now_ns),
            *self._notes,
        ]
        self._notes.clear()
        # A stopped session shows nothing and captures nothing, because that was asked for.
        if switch.activity is Activity.RUNNING and not switch.ended:
            found += [*self._staleness(now_ns), *self._inputs(now_ns)]
        for at_ns, what, text in sorted(found, key=lambda event: event[0]):
            self.number += 1
            at_us = at_ns // NS_PER_US
            self.events.append(Event(number=self.number, at_us=at_us, what=what, text=text))

    def handle_note(self, what: str, text: str, at_ns: int) -> None:
        """A person, or `kontur-av maintain`, has noted something; the next look tells it."""
        self._notes.append((at_ns, what, text))

    def after(self, number: int) -> list[Event]:
        """The kept events that come after the one with this number."""
        return [event for event in self.events if event.number > number]

    def _session(self, switch: SessionSwitch) -> Iterator[tuple[int, str, str]]:
        before, self._running = self._running, switch.activity is Activity.RUNNING
        if self._running != before:
            text = "session started" if self._running else "session stopped"
            yield switch.changed_ns, "session", text

    def _recorded(self) -> Iterator[tuple[int, str, str]]:
        """What processes record with its instants."""
        for segment in Segment:
            end = segment.value
            gateway = self._collector.gateway(segment)
            if gateway.link is not None:
                # Each kind for itself: a loss is dated back to the last frame before it.
                for kind, record in _supervised(gateway.link.supervision).items():
                    yield from self._fresh("link", end, record, end, kind)
            peer = gateway.find(PeerMetrics)
            if peer is not None:
                events = [(peer.begun_ns + event.at_ns, event.what) for event in peer.events]
                yield from self._fresh("link", end, events, end, "path")
        process = self._collector.process
        arm = process("robot").find(AuthorityMetrics)
        yield from self._dated("trainer", process(TRAINER).total(TrainerMetrics).exercises)
        yield from self._dated("camera", process("selector").total(SelectorMetrics).focuses)
        yield from self._dated("robot", () if arm is None else arm.events)
        yield from self._dated("robot", process("robot").total(SafetyMetrics).events, "stop")
        seat = process(PAGES[Segment.SPACE]).total(PageMetrics)
        yield from self._dated("handle", seat.drivers)
        # Events of users' components in telemetry, and their faults.
        for component in self._collector.topology.options.components:
            name = component.application.name
            told = process(component_process(name)).total(ComponentMetrics)
            yield from self._dated(name, told.events, "telemetry")

    def _dated(
        self, who: str, events: Sequence[DatedEvent | AuthorityEvent], *kind: str
    ) -> Iterator[tuple[int, str, str]]:
        record = [(event.at_ns, event.what) for event in events]
        return self._fresh("session", who, record, who, *kind)

    def _fresh(
        self, what: str, who: str, record: Sequence[tuple[int, str]], *key: str
    ) -> Iterator[tuple[int, str, str]]:
        """The instants and words of a record that were not told yet."""
        told_ns = self._told_ns.get(key, -1)
        for at_ns, text in record:
            if at_ns > told_ns:
                yield at_ns, what, f"{who}: {text}"
        self._told_ns[key] = max([told_ns, *(at_ns for at_ns, _ in record)])

    def _tasks(self, now_ns: int) -> Iterator[tuple[int, str, str]]:
        """Selection, start and end of the runs of tasks."""
        runs = self._collector.process(TASKS).total(TaskMetrics).runs
        for _, row in sorted(runs.items())[-KEPT:]:
            at_ns = {one.step: one.at_ns for one in row.steps}
            result = f"{row.result}: {row.reason}" if row.reason else row.result
            ended = "" if row.result == OPEN else result
            for stage, (step, text) in enumerate(
                (
                    (RunStep.SELECTED, "selected"),
                    (RunStep.STARTED, "started"),
                    (RunStep.ENDED, ended),
                )
            ):
                # The end of a killed process's run has no instant.
                came = step.value in at_ns or step is RunStep.ENDED
                if text and came and (row.run, stage) > self._task_told:
                    self._task_told = row.run, stage
                    words = f"task {row.name}, run {row.run}: {text}"
                    yield at_ns.get(step.value, now_ns), "session", words

    def _passes(self, started_ns: int, now_ns: int) -> Iterator[tuple[int, str, str]]:
        """Begin and end of the pass, as the orbit predicts them, and what is announced."""
        link = self._collector.gateway(self._collector.topology.segments[0]).link
        channel = None if link is None else link.radio.channel
        contact = None if channel is None else channel.contact
        for at_ns, text in self.upkeep.handle_look(contact, started_ns, now_ns):
            yield at_ns, UPKEEP, text
        if contact is None:
            return
        start_s = self._collector.setup.radio_profile.start_s
        pass_s = start_s + (now_ns - started_ns) / NS_PER_S
        before_s, self._pass_s = self._pass_s, pass_s
        for at_s, text in (
            (contact.acquisition_s, "radio: the pass begins"),
            (contact.loss_s, "radio: the pass ends"),
        ):
            if before_s is not None and before_s < at_s <= pass_s:
                yield started_ns + round((at_s - start_s) * NS_PER_S), "link", text

    def _cameras(self) -> Iterator[tuple[int, str, str]]:
        selector = self._collector.process("selector")
        if selector.selected not in (None, self._camera):
            self._camera = selector.selected
            yield selector.selected_ns, "camera", f"camera {self._camera} selected"

    def _restarted(
        self, processes: Sequence[ProcessNow], now_ns: int
    ) -> Iterator[tuple[int, str, str]]:
        for process in processes:
            if process.restarts > self._restarts.get(process.name, 0):
                why = f": {process.error}" if process.error else ""
                yield now_ns, "process", f"{process.name} was started again{why}"
            self._restarts[process.name] = process.restarts
            if self._collector.process(process.name).scheduler == "too_busy":
                if process.name not in self._too_busy:
                    yield now_ns, "process", f"{process.name} takes {TOO_BUSY}"
                self._too_busy.add(process.name)
            if process.trouble not in ("", self._troubled.get(process.name)):
                yield now_ns, "process", f"{process.name}: {process.trouble}"
        self._troubled = {process.name: process.trouble for process in processes}

    def _joysticks(self, now_ns: int) -> Iterator[tuple[int, str, str]]:
        joystick = self._collector.process("joystick").find(JoystickMetrics)
        if joystick is None:
            return
        now = joystick.state, joystick.reason
        before, self._joystick = self._joystick, now
        if now != before:
            state, reason = now
            yield now_ns, "joystick", f"joystick: {state}" + (f" ({reason})" if reason else "")

    def _robots(self, now_ns: int) -> Iterator[tuple[int, str, str]]:
        robot = self._collector.process("robot").find(RobotMetrics)
        before, self._fault = self._fault, "" if robot is None else robot.fault
        if self._fault != before:
            text = f"it is off: {self._fault}" if self._fault else "its fault is reset"
            yield now_ns, "session", f"robot: {text}"

    def _staleness(self, now_ns: int) -> Iterator[tuple[int, str, str]]:
        for stream in self._collector.setup.streams:
            state, age_ns = shown_now(stream, self._collector, now_ns)
            if state is State.NOTHING:
                continue
            stale = state is State.STALE
            if stale and not self._stale.get(stream.name, False):
                since_ns = now_ns
                if age_ns is not None:
                    since_ns -= age_ns - self._collector.setup.stale_after_ns(stream)
                yield since_ns, "stale", f"{stream.name} is stale"
            elif not stale and self._stale.get(stream.name, False):
                yield now_ns, "stale", f"{stream.name} is fresh again ({age_words(age_ns)} old)"
            self._stale[stream.name] = stale

    def _inputs(self, now_ns: int) -> Iterator[tuple[int, str, str]]:
        silent = {each.process: each for each in silences(self._collector, now_ns)}
        for name, silence in silent.items():
            if name not in self._silent:
                yield now_ns, "input", str(silence)
        for name in sorted(self._silent - silent.keys()):
            yield now_ns, "input", f"{name} gives again"
        self._silent = set(silent)
        for name in self._collector.setup.inputs:
            process = self._collector.topology.input(name).process
            capture = self._collector.process(process).capture
            fault, live = capture.source_fault, capture.live_source
            if fault and fault != self._faults.get(process):
                yield now_ns, "input", f"{process}: {fault}"
                self._faults[process] = fault
            if live is not None and live != self._live.get(process, "own"):
                who = "a page took over" if live == "page" else "its own source again"
                yield now_ns, "input", f"{name}: {who}"
                self._live[process] = live


def _supervised(supervision: SupervisionMetrics) -> dict[str, list[tuple[int, str]]]:
    """By kind: instants and words of what a gateway's record has of signal and state."""
    begun_ns, contacts = supervision.begun_ns, supervision.contacts
    changes = [
        (begun_ns + one["at_ns"], f"link {one['to']}", one["why"])
        for one in supervision.history
        if one["to"] in _TOLD_STATES or one["from"] in _TOLD_STATES
    ]
    return {
        "acquired": [(begun_ns + contact.acquired_ns, "signal acquired") for contact in contacts],
        "lost": [
            (begun_ns + one.lost_ns, "signal lost") for one in contacts if one.lost_ns is not None
        ],
        "state": [(at_ns, f"{text} ({why})" if why else text) for at_ns, text, why in changes],
    }
