"""What a systems operator must know at once: experiment, contact ahead, bandwidth. A core."""

from collections.abc import Iterator, Sequence
from typing import Final, NamedTuple

from kontur_av.clock import NS_PER_S
from pipelines.mission.mission_metrics import TaskMetrics
from pipelines.report.collector import Collector, ProcessMetrics
from pipelines.seats.page_metrics import PageMetrics
from pipelines.session.setup.segments import Segment
from pipelines.session.task_journal import OPEN
from pipelines.session.topology.topics import JOYSTICK, PAGES, ROBOT, TASKS
from telepresence.haptics.device.states import JoystickState
from telepresence.haptics.envelope import Hold, SafetyMetrics
from telepresence.haptics.haptic_metrics import JoystickMetrics
from telepresence.haptics.specs import PAGE, is_simulated
from telepresence.link.link_metrics import ContactWindows
from telepresence.link.radio.profile import RadioProfile

#: An event that was found before it happens, or that lasts.
UPKEEP: Final = "upkeep"
#: A person who lets go for a moment has not ended the experiment.
_REST_NS: Final = 10 * NS_PER_S
#: A coming event is announced this long before.
LEADS_S: Final = (60, 10)
#: Bandwidth is short until nothing was dropped for this long.
_SHORT_NS: Final = 10 * NS_PER_S
#: Files may wait; they never count.
_MEDIA: Final = ("tmtc", "voice", "video")
#: Drops without contact say nothing about bandwidth.
_NO_CONTACT: Final = "signal_lost"


class Planned(NamedTuple):
    """An event of the pass. at_s: from acquisition of signal.

    on_time: it is announced when it comes, too. A gateway tells the others itself.
    """

    at_s: float
    what: str
    on_time: bool


def planned_contact(profile: RadioProfile, windows: ContactWindows | None) -> tuple[Planned, ...]:
    """Return acquisition and loss of signal, drop-outs and shadowing, in order.

    Blackouts of a profile are shadowing: the masts and modules that cause them are known before.
    windows: what the orbit predicts; None without an orbit.
    """
    found = []
    if windows is not None:
        found += [
            Planned(windows.acquisition_s, "acquisition of signal", on_time=False),
            Planned(windows.loss_s, "loss of signal", on_time=False),
        ]
        if windows.usable_from_s is not None and windows.usable_to_s is not None:
            found += [
                Planned(windows.usable_from_s, "end of drop-outs", on_time=True),
                Planned(windows.usable_to_s, "drop-outs", on_time=True),
            ]
    for each in profile.blackouts:
        way = "" if each.direction == "both" else f" of the {each.direction}"
        at_s = profile.start_s + each.start_s
        found += [
            Planned(at_s, f"shadowing{way}", on_time=True),
            Planned(at_s + each.seconds, f"end of shadowing{way}", on_time=True),
        ]
    return tuple(sorted(found))


class ContactAhead:
    """Announces each event of the pass, at each of `LEADS_S` before it and when it comes."""

    def __init__(self, plan: Sequence[Planned]) -> None:
        self._plan = plan
        #: By event: how many leads were announced.
        self._told = [0] * len(plan)
        self._before_s: float | None = None

    def handle_time(self, pass_s: float) -> Iterator[tuple[float, str]]:
        """Yield announcements: the instant in the pass, and words."""
        for index, each in enumerate(self._plan):
            left_s = each.at_s - pass_s
            leads = sum(left_s <= lead for lead in LEADS_S)
            if left_s >= 1 and leads > self._told[index]:
                yield pass_s, f"{each.what} in {round(left_s)} s"
            self._told[index] = leads
            came = self._before_s is not None and self._before_s < each.at_s <= pass_s
            if came and each.on_time:
                yield each.at_s, each.what
        self._before_s = pass_s

    @property
    def next(self) -> tuple[str, float] | None:
        """What comes next, and in how many seconds; None if nothing does."""
        now_s = self._before_s
        if now_s is None:
            return None
        ahead = (each for each in self._plan if each.at_s > now_s)
        return next(((each.what, each.at_s - now_s) for each in ahead), None)


class ExperimentWatch:
    """Tells whether an experiment runs, during which nothing may be updated.

    It runs while a task runs, or a person has the arm; a simulated hand is no person. attached: the
    user's programs are behind the gateways; only their haptic samples tell what they do.
    """

    def __init__(self, collector: Collector, *, attached: bool = False) -> None:
        self._collector, self._attached = collector, attached
        self._words, self._seen_ns = "", 0
        self._samples = 0

    def handle_time(self, now_ns: int) -> str:
        """Return what runs, in words; "" if nothing does."""
        if self._attached:
            words = self._attached_words()
        else:
            words = self._task(now_ns) or self._hand(now_ns)
        if words:
            self._words, self._seen_ns = words, now_ns
        elif now_ns - self._seen_ns >= _REST_NS:
            self._words = ""
        return self._words

    def _telling(self, name: str, now_ns: int) -> ProcessMetrics:
        """Return the figures of a process; none if it was stopped, because its last ones stay."""
        process = self._collector.process(name)
        return process if now_ns - process.told_ns < _REST_NS else ProcessMetrics()

    def _task(self, now_ns: int) -> str:
        runs = self._telling(TASKS, now_ns).total(TaskMetrics).runs
        row = runs[max(runs)] if runs else None
        return f"{row.name}, run {row.run}" if row is not None and row.result == OPEN else ""

    def _hand(self, now_ns: int) -> str:
        topology = self._collector.topology
        spec, here = topology.options.joystick, topology.segments
        if Segment.SPACE in here and is_simulated(spec):
            return ""
        if self._telling(PAGES[Segment.SPACE], now_ns).total(PageMetrics).holder:
            return "a page has the handle"
        robot = self._telling(ROBOT, now_ns).find(SafetyMetrics)
        if robot is not None and robot.hold is Hold.NONE:
            return "the robot follows the hand"
        # Only with the robot elsewhere; a page's joystick is in APPLICATION without a person, too.
        joystick = self._telling(JOYSTICK, now_ns).find(JoystickMetrics)
        driven = joystick is not None and joystick.state == JoystickState.APPLICATION.words
        return "the joystick drives" if driven and here == (Segment.SPACE,) and spec != PAGE else ""

    def _attached_words(self) -> str:
        samples = 0
        for segment in self._collector.topology.segments:
            link = self._collector.gateway(segment).link
            if link is not None:
                sent = link.transmit.haptic_sent + link.transmit.haptic_superseded
                samples += sent + link.receive.haptic_received
        before, self._samples = self._samples, samples
        return "haptic samples pass" if samples > before else ""


class BandwidthWatch:
    """Warns where a gateway drops media for want of bandwidth."""

    def __init__(self, collector: Collector) -> None:
        self._collector = collector
        self._drops: dict[tuple[str, str], int] = {}
        #: By direction and level: when a packet was dropped last.
        self.short_ns: dict[tuple[str, str], int] = {}

    def handle_time(self, now_ns: int) -> Iterator[str]:
        """Yield a line when a shortage begins, and when it is over."""
        for segment in self._collector.topology.segments:
            link = self._collector.gateway(segment).link
            queues = {} if link is None else link.transmit.queue
            for level in _MEDIA:
                key = segment.transmits.value, level
                counts = queues[level].drops if level in queues else {}
                drops = sum(count for why, count in counts.items() if why != _NO_CONTACT)
                before, self._drops[key] = self._drops.get(key, 0), drops
                if drops > before:
                    if key not in self.short_ns:
                        yield f"{key[0]} is short of bandwidth: {level} is dropped"
                    self.short_ns[key] = now_ns
                elif now_ns - self.short_ns.get(key, now_ns) >= _SHORT_NS:
                    del self.short_ns[key]
                    yield f"{key[0]}: {level} has its bandwidth again"


class UpkeepNow:
    """Experiment, contact ahead and bandwidth of a session. Call `handle_look` once a second."""

    def __init__(self, collector: Collector) -> None:
        self._collector = collector
        self._watch = ExperimentWatch(collector)
        self._bandwidth = BandwidthWatch(collector)
        self._ahead: ContactAhead | None = None
        #: What runs, in words; "" if nothing does.
        self.experiment = ""

    @property
    def short(self) -> str:
        """Where bandwidth is short, in words."""
        return ", ".join(f"{way} {level}" for way, level in sorted(self._bandwidth.short_ns))

    @property
    def next(self) -> tuple[str, float] | None:
        return None if self._ahead is None else self._ahead.next

    def handle_look(
        self, windows: ContactWindows | None, started_ns: int, now_ns: int
    ) -> Iterator[tuple[int, str]]:
        """Yield what is new: its instant, and words.

        windows: what the orbit predicts, once a gateway has told it. started_ns: when the session
        began.
        """
        self.experiment = self._watch.handle_time(now_ns)
        profile = self._collector.setup.radio_profile
        if self._ahead is None and (windows is not None or profile.contact is None):
            self._ahead = ContactAhead(planned_contact(profile, windows))
        if self._ahead is not None:
            pass_s = profile.start_s + (now_ns - started_ns) / NS_PER_S
            for at_s, words in self._ahead.handle_time(pass_s):
                yield started_ns + round((at_s - profile.start_s) * NS_PER_S), words
        yield from ((now_ns, words) for words in self._bandwidth.handle_time(now_ns))
