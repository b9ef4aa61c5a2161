"""People of a study on virtual time: the simulated hands of tasks, with skills that differ. A core.

The same desk leads them. They differ in skill and grip, and become better while they do it, so
that an order which is not balanced would show.
"""

from collections.abc import Iterator
from dataclasses import replace
from math import exp, hypot
from random import Random

from kontur_av.clock import NS_PER_MS, NS_PER_S
from pipelines.study.desk import StudyDesk, StudyFrame, StudyPhase, StudyPress
from pipelines.study.plan import StudyPlan
from pipelines.study.trial import TrialResult
from telepresence.haptics.device.simulated import SimulatedDevice
from telepresence.haptics.hand import SOFT_GRIP
from telepresence.tasks.cosmonaut import LOOK_NS, Cosmonaut, Skill

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
    desk = StudyDesk(plan, device, dict.fromkeys(range(1, participant), plan.trials_each))
    now_ns = 0
    desk.handle_time(now_ns)
    while desk.phase is not StudyPhase.DONE:
        frame = desk.frame
        if frame is None:
            now_ns += max(_READING_NS, round(desk.show(now_ns).wait_s * NS_PER_S))
            desk.handle_time(now_ns)
            desk.handle_press(StudyPress(desk.show(now_ns).screen), now_ns)
            continue
        hand.watch(frame, moving=desk.trial.moves, now_ns=now_ns)
        for _ in range(LOOK_NS // NS_PER_MS):
            now_ns += NS_PER_MS
            desk.handle_time(now_ns)
        while (result := desk.next_result()) is not None:
            hand.practise(result.trial)
            yield result
