"""Leads people through a study: what the page shows, and which trial counts. A core.

A trial begins when the dot rests at its start, with the hand on the handle. Who lets go in a trial
begins it again. After an interruption the study goes on with the first trial that is not finished.
"""

from collections import deque
from collections.abc import Iterator, Mapping
from dataclasses import replace
from enum import Enum
from math import exp, hypot
from random import Random

import msgspec

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.errors import ConfigError, ProtocolError, refused
from pipelines.study.plan import HandleCondition, StudyPlan, StudyTrial, TrialResult, trials_of
from telepresence.haptics.device.device import JoystickDevice
from telepresence.haptics.device.page import PageDevice
from telepresence.haptics.device.simulated import Mechanics, SimulatedDevice
from telepresence.haptics.device.states import JoystickState
from telepresence.haptics.hand import SOFT_GRIP
from telepresence.tasks.cosmonaut import LOOK_NS, Cosmonaut, Skill

#: The dot is at the start within this distance, and rests there for this long. Chosen.
START_M = 0.005
_REST_NS = 700 * NS_PER_MS
#: After a longer pause of this program the trial is void: the handle stood still.
_STALL_NS = 100 * NS_PER_MS
_HOW = (
    "Press the mouse button or a finger on the field, keep it pressed, and drag the dot. "
    "Or hold Space and press the arrow keys."
)


_HOW_HELD = "Hold the joystick's dead-man button, keep it held, and move its handle."


def check_handle(plan: StudyPlan, device: JoystickDevice) -> None:
    """Raise ConfigError unless a joystick with motors can be the handle of a study."""
    has, handle = device.capabilities, plan.handle
    name = f"joystick {has.name}"
    if not has.has_force:
        raise ConfigError(f"{name} has no motors, which change a handle: take one that has")
    if any(handle.inertia_kg):
        raise ConfigError(
            f"{name}: its motors render no inertia stably: leave inertia_kg out of the plan, or "
            "take the simulated handle of the page"
        )
    reach_m = max(task.reach_m for task in plan.tasks)
    half_m = min(has.half_width_m, has.half_height_m)
    if reach_m > half_m:
        raise ConfigError(
            f"{name} goes {half_m:g} m to each side, and targets {reach_m:g} m: bring them closer"
        )
    if (pull_n := max(handle.stiffness_n_m) * reach_m) > has.force_limit_n:
        raise ConfigError(
            f"{name} has {has.force_limit_n:g} N, and the stiffest handle {pull_n:.1f} N at the "
            f"farthest target: take at most {int(has.force_limit_n / reach_m)} N/m"
        )


class StudyPhase(Enum):
    """What a person does now."""

    CONSENT = "consent"
    RETURN = "return"
    READ = "read"
    START = "start"
    TRIAL = "trial"
    BREAK = "break"
    DONE = "done"


class StudyShown(msgspec.Struct, frozen=True, kw_only=True, tag="study", tag_field="kind"):
    """What a page of the study says. screen: its number, which a press names.

    main, other: words of the buttons; "" for none. wait_s: until they can be pressed. trial: the
    number of those that are finished, of `trials`. half_width_m, half_height_m: the field.
    """

    screen: int
    phase: StudyPhase
    title: str
    words: tuple[str, ...]
    main: str
    other: str
    wait_s: float
    trial: int
    trials: int
    half_width_m: float
    half_height_m: float


class StudyFrame(msgspec.Struct, frozen=True, kw_only=True, tag="frame", tag_field="kind"):
    """Where dot and target are. starting: the target is the start. rest: how long the dot has
    rested there, 0 to 1."""

    x_m: float
    y_m: float
    target_x_m: float
    target_y_m: float
    radius_m: float
    starting: bool
    rest: float


class StudyPress(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A press of a button. screen: the one on which it was seen. other: the second button."""

    screen: int
    other: bool = False


def parse_press(text: str) -> StudyPress:
    """What a page sends as text; ProtocolError for anything else."""
    with refused(
        "no press of a button", msgspec.DecodeError, RecursionError, raising=ProtocolError
    ):
        return msgspec.json.decode(text, type=StudyPress)


class StudyTrials:
    """Call `handle_time` often, at least every 20 ms. `next_result` has each finished trial.

    device: the handle: in the hand of a page, simulated, or one with motors. finished: how many
    trials of each participant are on record. phase: what a person does. trial: the one that is
    done or begun.
    """

    def __init__(
        self,
        plan: StudyPlan,
        device: JoystickDevice,
        finished: Mapping[int, int],
    ) -> None:
        self._how = _HOW if isinstance(device, PageDevice) else _HOW_HELD
        #: A simulated handle is moved by its muscles whether its button is held or not.
        self._simulated = isinstance(device, Mechanics)
        self._plan, self._device, self._finished = plan, device, dict(finished)
        self._now_ns = self._until_ns = self._rest_ns = 0
        self._speed = (0.0, 0.0)
        self._results: deque[TrialResult] = deque()
        self._screen, self._attempts = 0, 1
        self._why = ""
        device.show_state(JoystickState.APPLICATION)
        self._admit(1)

    def handle_press(self, press: StudyPress, now_ns: int) -> None:
        """A button was pressed; one of an older screen, or one that must wait, does nothing."""
        shown = self.show(now_ns)
        label = shown.other if press.other else shown.main
        if press.screen != shown.screen or not label or shown.wait_s > 0.0:
            return
        if press.other:
            self._admit(self._participant + 1)
        elif self.phase is StudyPhase.DONE:
            self._admit(1)
        else:
            self._enter(StudyPhase.START if self.phase is StudyPhase.READ else StudyPhase.READ)

    def handle_time(self, now_ns: int) -> None:
        """Move the handle up to now."""
        passed_ns = now_ns - self._now_ns
        if passed_ns > _STALL_NS or self.phase not in (StudyPhase.START, StudyPhase.TRIAL):
            self._void("This computer was busy, so this trial begins again.")
            self._now_ns = now_ns
            if not self._simulated:
                self._device.write_force(0.0, 0.0)
            return
        for _ in range(passed_ns // NS_PER_MS):
            self._now_ns += NS_PER_MS
            if self.phase in (StudyPhase.START, StudyPhase.TRIAL):
                self._step()

    def next_result(self) -> TrialResult | None:
        return self._results.popleft() if self._results else None

    @property
    def frame(self) -> StudyFrame | None:
        """What the page draws; None without a field."""
        if self.phase not in (StudyPhase.START, StudyPhase.TRIAL):
            return None
        reading, trial = self._device.read(), self.trial
        starting = self.phase is StudyPhase.START
        x_m, y_m = trial.start_m if starting else trial.target_m
        return StudyFrame(
            x_m=reading.x_m,
            y_m=reading.y_m,
            target_x_m=x_m,
            target_y_m=y_m,
            radius_m=START_M if starting else trial.task.width_m / 2.0,
            starting=starting,
            rest=min(1.0, self._rest_ns / _REST_NS),
        )

    def show(self, now_ns: int) -> StudyShown:
        title, words, main, other = self._said()
        return StudyShown(
            screen=self._screen,
            phase=self.phase,
            title=title,
            words=tuple(filter(None, (self._why, *words))),
            main=main,
            other=other,
            wait_s=max(0, self._until_ns - now_ns) / NS_PER_S
            if self.phase is StudyPhase.BREAK
            else 0.0,
            trial=self._index,
            trials=self._plan.trials_each,
            half_width_m=self._device.capabilities.half_width_m,
            half_height_m=self._device.capabilities.half_height_m,
        )

    def _admit(self, first: int) -> None:
        """Show the first screen of the first participant, from `first` on, who is not through."""
        plan, finished = self._plan, self._finished
        everybody = range(first, plan.participants + 1)
        left = [one for one in everybody if finished.get(one, 0) < plan.trials_each]
        self._participant = left[0] if left else plan.participants
        self._trials = trials_of(plan, self._participant)
        self._index = finished.get(self._participant, 0)
        begun = StudyPhase.RETURN if self._index else StudyPhase.CONSENT
        self._enter(begun if left else StudyPhase.DONE)

    @property
    def _others(self) -> bool:
        """Whether later participants have not begun."""
        later = range(self._participant + 1, self._plan.participants + 1)
        return any(one not in self._finished for one in later)

    def _step(self) -> None:
        device = self._device
        device.advance(NS_PER_MS)
        reading = device.read()
        x_m, y_m, vx_m_s, vy_m_s = reading[:4]
        condition: HandleCondition = self.trial.planned.condition
        stiffness, damping = condition.stiffness_n_m, condition.damping_n_s_m
        force_x, force_y = (
            -stiffness * x_m - damping * vx_m_s,
            -stiffness * y_m - damping * vy_m_s,
        )
        if not self._simulated and not reading.dead_man:
            force_x = force_y = 0.0
        device.write_force(force_x, force_y)
        # The hand feels the inertia, too.
        force_x -= 1000.0 * condition.inertia_kg * (vx_m_s - self._speed[0])
        force_y -= 1000.0 * condition.inertia_kg * (vy_m_s - self._speed[1])
        self._speed = vx_m_s, vy_m_s
        if not reading.present or reading.error:
            self._void(f"The joystick stopped ({reading.error or 'it is gone'}): begin again.")
            self._rest_ns = 0
        elif self.phase is StudyPhase.START:
            start = self.trial.start_m
            near = hypot(x_m - start[0], y_m - start[1]) <= START_M
            self._rest_ns = self._rest_ns + NS_PER_MS if near and reading.dead_man else 0
            if self._rest_ns >= _REST_NS:
                self._enter(StudyPhase.TRIAL)
        elif not reading.dead_man:
            self._void("The handle was let go, so this trial begins again.")
        else:
            self.trial.step(x_m, y_m, hypot(force_x, force_y))
            if self.trial.finished:
                self._finish()

    def _void(self, why: str) -> None:
        if self.phase is StudyPhase.TRIAL:
            self._enter(StudyPhase.START, why)

    def _finish(self) -> None:
        self._index += 1
        self._finished[self._participant] = self._index
        note, attempts = self._plan.note, self._attempts
        self._attempts = 1
        self._results.append(self.trial.result(number=self._index, attempts=attempts, note=note))
        if self._index == len(self._trials):
            self._enter(StudyPhase.DONE)
            return
        last, planned = self._trials[self._index - 1 : self._index + 1]
        if planned.place > last.place and last.place % self._plan.break_every == 0:
            self._until_ns = self._now_ns + round(self._plan.break_s * NS_PER_S)
            self._enter(StudyPhase.BREAK)
        else:
            self._enter(StudyPhase.READ if planned.opens else StudyPhase.START)

    def _enter(self, phase: StudyPhase, why: str = "") -> None:
        self.phase, self._why = phase, why
        self._screen += 1
        if phase is StudyPhase.START:
            self._attempts += bool(why)
            self._rest_ns = 0
            self.trial = StudyTrial(self._trials[self._index])
            if isinstance(self._device, Mechanics):
                self._device.joystick.virtual_kg = self.trial.planned.condition.inertia_kg

    def _said(self) -> tuple[str, tuple[str, ...], str, str]:
        """Title, words, and the two buttons of the screen."""
        plan, phase, person = self._plan, self.phase, f"participant {self._participant}"
        if phase is StudyPhase.CONSENT:
            kept = f"You are {person}. No name is kept. You may stop at any time."
            return plan.name, (plan.consent, kept), "I agree: begin", ""
        if phase is StudyPhase.RETURN:
            other = "Another person" if self._others else ""
            return "Go on?", (f"For {person}, trials are left to do.",), "Go on", other
        if phase is StudyPhase.DONE:
            return "Thank you", ("That was all.",), "Next person" if self._others else "", ""
        if phase is StudyPhase.BREAK:
            return "A break", ("Rest your hand.",), "Go on", ""
        planned = self._trials[self._index]
        task, title = planned.task, planned.task.name.capitalize()
        if phase is StudyPhase.READ:
            count = f"Trials for practice: {plan.practice}; that count: {plan.trials}. "
            count += "The handle may feel different from before."
            return title, (task.words, self._how, count), "Begin", ""
        title += f", {'trial' if planned.counts else 'practice'} {planned.repetition}"
        if phase is StudyPhase.START:
            return title, (f"Bring the dot into the ring, and rest there. {self._how}",), "", ""
        return title, (task.words,), "", ""


#: Mean and standard deviation of the skill at first; how much is learned, after so many trials.
_SKILL, _SKILL_SPREAD, _LEARNED, _LEARNING_TRIALS = 0.5, 0.12, 0.3, 20.0
#: Standard deviation of the logarithm of the grip's stiffness.
_GRIP_SPREAD = 0.2
#: A hand waits this long at each screen.
_READING_NS = NS_PER_S
#: A hand that is nearer than this to the middle of a circle corrects no more.
_CONTENT_M = 0.002
#: Within this distance it leans more at each look, by this share of what is missing.
_NEAR_M, _LEAN = 0.02, 0.05


class StudyHand(Cosmonaut):
    """Aims at what stands still, and follows what moves. `watch` says what the page draws."""

    dead_man = True

    def __init__(self, seed: int) -> None:
        chance = Random(seed)
        firmer = exp(chance.gauss(0.0, _GRIP_SPREAD))
        model = replace(
            SOFT_GRIP,
            stiffness_n_m=SOFT_GRIP.stiffness_n_m * firmer,
            damping_n_s_m=SOFT_GRIP.damping_n_s_m * firmer,
        )
        self._first = min(0.8, max(0.1, chance.gauss(_SKILL, _SKILL_SPREAD)))
        super().__init__(Skill(level=self._first), seed=seed + 1, model=model)
        self._target: tuple[float, float] | None = None
        self._target_ns = 0
        self._lean = (0.0, 0.0)

    def practise(self, trials: int) -> None:
        """So many trials are done."""
        learned = _LEARNED * (1.0 - exp(-trials / _LEARNING_TRIALS))
        self.skill = Skill(level=min(1.0, self._first + learned))

    def watch(self, frame: StudyFrame, *, moving: bool, now_ns: int) -> None:
        """See dot and target; what has only just appeared is not acted on."""
        place, last = (frame.target_x_m, frame.target_y_m), self._target
        if last is None or max(abs(place[0] - last[0]), abs(place[1] - last[1])) > _CONTENT_M * 2:
            self._target_ns, self._lean = now_ns, (0.0, 0.0)
        self._target = place
        if now_ns - self._target_ns < self.skill.reaction_ns:
            return
        seen = frame.x_m, frame.y_m
        if moving and not frame.starting:
            # Near it, the hand leans against what holds the dot back.
            miss_x, miss_y = place[0] - seen[0], place[1] - seen[1]
            if hypot(miss_x, miss_y) < _NEAR_M:
                self._lean = self._lean[0] + _LEAN * miss_x, self._lean[1] + _LEAN * miss_y
            to = place[0] + self._lean[0], place[1] + self._lean[1]
            self.track(to, speed_m_s=2.0 * self.skill.speed_m_s)
        else:
            self.aim(place, within_m=_CONTENT_M, seen_m=seen)


def simulate_person(plan: StudyPlan, participant: int, seed: int) -> Iterator[TrialResult]:
    """All trials of one simulated participant, as they finish."""
    hand = StudyHand(seed * 1_000_003 + participant)
    device = SimulatedDevice(hand=hand, start_m=(0.0, 0.0))
    service = StudyTrials(plan, device, dict.fromkeys(range(1, participant), plan.trials_each))
    now_ns = 0
    service.handle_time(now_ns)
    while service.phase is not StudyPhase.DONE:
        frame = service.frame
        if frame is None:
            now_ns += max(_READING_NS, round(service.show(now_ns).wait_s * NS_PER_S))
            service.handle_time(now_ns)
            service.handle_press(StudyPress(service.show(now_ns).screen), now_ns)
            continue
        hand.watch(frame, moving=service.trial.moves, now_ns=now_ns)
        for _ in range(LOOK_NS // NS_PER_MS):
            now_ns += NS_PER_MS
            service.handle_time(now_ns)
        while (result := service.next_result()) is not None:
            hand.practise(result.trial)
            yield result
