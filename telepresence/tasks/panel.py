"""The mission control panel: what the cosmonaut is told, and when a task begins. A core.

Stelzer et al. 2017, section 5 and Fig. 14. A state machine decides what is shown:
no contact, wait for a task, its description, the way to the start position, hold it, press the
dead-man button, the task, its end.
"""

from collections import deque
from dataclasses import dataclass, replace
from math import hypot

from kontur_av.clock import NS_PER_S
from telepresence.tasks.definitions import SpotPath
from telepresence.tasks.positions import spot_at
from telepresence.tmtc.k2aci import (
    K2aciMessage,
    PanelMode,
    PanelState,
    StartTask,
    TaskFinished,
    TaskGoal,
    TaskProgress,
    TaskResult,
    TaskSelected,
    fitted_line,
)

#: The handle is at the start position within this distance, for this long.
START_WITHIN_M = 0.005
HOLD_NS = 3 * NS_PER_S

_SIGNAL_WORDS = "No contact to the ground."
_WORDS = {
    PanelMode.NO_CONTACT: _SIGNAL_WORDS,
    PanelMode.WAIT_TASK: "Wait for a task.",
    PanelMode.TASK_INFO: "Read what is to be done. Then press the button.",
    PanelMode.MOVE_TO_START: "Move the handle to the start position.",
    PanelMode.HOLD: "Hold it there.",
    PanelMode.PRESS_DEADMAN: "Press it now, and keep it pressed: the mouse button, your finger, "
    "Space, the trigger, or the dead-man button of the joystick.",
    PanelMode.RUNNING: "",
}
_LET_GO = (
    "Well held. Now let go of the mouse button, your finger, Space, the trigger, or the dead-man "
    "button of the joystick. Then press it again."
)
_RESULT_WORDS = {
    TaskResult.ABORTED: "The task was aborted.",
    TaskResult.TIMED_OUT: "The task took too long.",
    TaskResult.LOST_SIGNAL: "The signal was lost.",
}
#: What a goal shows on the board; a spot moves.
_SPOTS = {TaskGoal.CIRCLE: SpotPath.CIRCLE, TaskGoal.EIGHT: SpotPath.EIGHT}
#: Goals of two hands; where they are to go may be unknown.
_HANDS = (TaskGoal.HANDS, TaskGoal.BALL)
#: The states in which the handle leads from one to the next.
_AT_HANDLE = (PanelMode.MOVE_TO_START, PanelMode.HOLD, PanelMode.PRESS_DEADMAN)
#: The states in which a joystick that halts ends the task.
_BUSY = (PanelMode.TASK_INFO, *_AT_HANDLE, PanelMode.RUNNING)


@dataclass(frozen=True, kw_only=True, slots=True)
class PanelView:
    """What the panel shows.

    task: "" without one. text: of the task. words: status or instruction. start_m: best place
    to begin. held_s, hold_s: how long start position or goal has been held, and is to be held.
    left_s: until the run ends without it; None while nothing limits it.
    goal: what is to be done in the run, a `TaskGoal`; "" without. target_m: its place.
    step, steps, percent, force_n: as in `TaskProgress`.
    """

    mode: PanelMode
    task: str
    run: int
    text: str
    words: str
    start_m: tuple[float, float]
    held_s: float
    hold_s: float = 0.0
    left_s: float | None = None
    goal: str = ""
    target_m: tuple[float, float] | None = None
    step: int = 0
    steps: int = 0
    percent: int = 0
    force_n: float = 0.0


class MissionPanel:
    """The state machine. After each input, send what `poll_message` returns until it is None."""

    def __init__(self) -> None:
        self.mode = PanelMode.NO_CONTACT
        self._task = TaskSelected(task="-", run=0)
        self._known = False
        self._words = self._reason = ""
        self._dead_man = False
        self._held_since_ns = self._now_ns = 0
        self._progress: TaskProgress | None = None
        self._told_ns = 0
        self._messages: deque[K2aciMessage] = deque()

    @property
    def view(self) -> PanelView:
        task, mode = self._task, self.mode
        held_ns = self._now_ns - self._held_since_ns if mode is PanelMode.HOLD else 0
        words = _WORDS.get(mode, self._words)
        if held_ns >= HOLD_NS and self._dead_man:
            words = _LET_GO
        progress = self._progress if mode in _BUSY else None
        view = PanelView(
            mode=mode,
            task=task.task if self._known else "",
            run=task.run if self._known else 0,
            text=task.text if self._known else "",
            words=words or task.text,
            start_m=self._start_m,
            held_s=held_ns / NS_PER_S,
            hold_s=HOLD_NS / NS_PER_S if mode is PanelMode.HOLD else 0.0,
        )
        return view if progress is None else self._with_progress(view, progress)

    def _with_progress(self, view: PanelView, told: TaskProgress) -> PanelView:
        if (told.goal is TaskGoal.START) is (view.mode is PanelMode.RUNNING):
            # The run has begun, and the robot is not ready for its first goal.
            return view
        since_s = (self._now_ns - self._told_ns) / NS_PER_S
        view = replace(view, left_s=max(0.0, told.left_ms / 1e3 - since_s))
        if told.goal is TaskGoal.START:
            return view
        target_m: tuple[float, float] | None = None
        if told.goal in _SPOTS:
            target_m = spot_at(_SPOTS[told.goal], since_s * 1e3 / told.turn_ms)
        elif told.goal is TaskGoal.REACH or (told.goal in _HANDS and any(told.position_um)):
            target_m = told.position_um[0] / 1e6, told.position_um[1] / 1e6
        hold_s = told.hold_ms / 1e3
        return replace(
            view,
            goal=told.goal.value,
            target_m=target_m,
            step=told.step,
            steps=told.steps,
            percent=told.percent,
            force_n=told.force_mn / 1e3,
            hold_s=hold_s,
            held_s=min(hold_s, told.held_ms / 1e3 + since_s) if told.held_ms else 0.0,
        )

    def handle_contact(self, contact: bool, now_ns: int) -> None:
        """Whether there is contact to the ground. A task that was being done is over without it."""
        self._now_ns = now_ns
        if not contact:
            self._known = False
            self._go(PanelMode.NO_CONTACT)
        elif self.mode is PanelMode.NO_CONTACT:
            self._go(PanelMode.WAIT_TASK)

    def handle_message(self, message: K2aciMessage, now_ns: int) -> None:
        """The ground has selected a task, or says that it is over. Others are ignored."""
        self._now_ns = now_ns
        if isinstance(message, TaskSelected):
            # The ground may say it twice.
            if not (self._known and message == self._task and self.mode in _BUSY):
                self._task, self._known, self._progress = message, True, None
                self._go(PanelMode.TASK_INFO)
        elif isinstance(message, TaskProgress):
            if self._known and message.run == self._task.run:
                self._progress, self._told_ns = message, now_ns
        elif isinstance(message, TaskFinished):
            if not self._known or (message.task, message.run) != (self._task.task, self._task.run):
                return
            if message.result is TaskResult.FINISHED:
                score = f": {message.reason}" if message.reason else ""
                self._words = f"Finished in {message.duration_ms / 1e3:.1f} s{score}."
                self._go(PanelMode.FINISHED)
            else:
                self._fail(_RESULT_WORDS[message.result] + self._why(message), message.reason)

    def handle_button(self, now_ns: int) -> None:
        """The button of the joystick, or the key, that moves the panel on was pressed."""
        self._now_ns = now_ns
        if self.mode is PanelMode.TASK_INFO:
            self._go(PanelMode.MOVE_TO_START)
        elif self.mode in (PanelMode.FINISHED, PanelMode.ERROR):
            self._known = False
            self._go(PanelMode.WAIT_TASK)

    def handle_handle(
        self, x_m: float, y_m: float, *, dead_man: bool, halted: str, now_ns: int
    ) -> None:
        """Where the handle is; call it at least ten times a second.

        dead_man: pressed. halted: why the joystick cannot be used; "" if it can.
        """
        self._now_ns, self._dead_man = now_ns, dead_man
        if halted and self.mode in _BUSY:
            self._fail(halted, halted)
        if self.mode not in _AT_HANDLE:
            return
        start_x_m, start_y_m = self._start_m
        if hypot(x_m - start_x_m, y_m - start_y_m) > START_WITHIN_M:
            self._go(PanelMode.MOVE_TO_START)
        elif self.mode is PanelMode.MOVE_TO_START:
            self._held_since_ns = now_ns
            self._go(PanelMode.HOLD)
        elif self.mode is PanelMode.HOLD and now_ns - self._held_since_ns >= HOLD_NS:
            # A button that was pressed all the time is no start.
            self._go(PanelMode.PRESS_DEADMAN if not dead_man else PanelMode.HOLD)
        elif self.mode is PanelMode.PRESS_DEADMAN and dead_man:
            self._messages.append(StartTask(task=self._task.task, run=self._task.run))
            self._go(PanelMode.RUNNING)

    def poll_message(self) -> K2aciMessage | None:
        """Return the next message for the ground, or None."""
        return self._messages.popleft() if self._messages else None

    @property
    def _start_m(self) -> tuple[float, float]:
        x_um, y_um = self._task.start_um
        return x_um / 1e6, y_um / 1e6

    def _why(self, message: TaskFinished) -> str:
        """Why it did not finish; of a step that took too long, its number and not its name."""
        told = self._progress
        if message.result is TaskResult.TIMED_OUT and told and told.goal is not TaskGoal.START:
            return f" Step {told.step} of {told.steps} was not done in time." * (told.steps > 1)
        return f" Reason: {message.reason}." if message.reason else ""

    def _fail(self, words: str, reason: str) -> None:
        self._words, self._reason = words, fitted_line(reason)
        self._go(PanelMode.ERROR)

    def _go(self, mode: PanelMode) -> None:
        if mode is self.mode:
            return
        self.mode = mode
        task, run = (self._task.task, self._task.run) if self._known else ("", 0)
        reason = self._reason if mode is PanelMode.ERROR else ""
        self._messages.append(PanelState(mode=mode, task=task, run=run, reason=reason))
