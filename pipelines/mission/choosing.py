"""The selector on the ground: which camera goes up, and which part of its picture is finest."""

from collections import deque
from collections.abc import Sequence

from kontur_av.codecs.region import Focus
from kontur_av.errors import ConfigError
from pipelines.media.following import AGAIN_NS, Choice
from pipelines.media.media_metrics import SelectorMetrics
from pipelines.mission.tmtc_messages import FunctionAsked, FunctionDone, RaiseEvent, SetValues
from pipelines.session.probe import Probe
from pipelines.session.session_metrics import DatedEvent

CAMERA = "camera"
SELECT, FOCUS = "select", "focus"
_SUPERSEDED = "a later request came"
#: Telecommands that wait for the sender; beyond this the oldest is never completed by it.
_MOST_OPEN = 16
#: Changes of the focus that the report has.
_MOST_KEPT = 200


class CameraChoice:
    """Decides which camera the sender of the picture follows. A core.

    After each input publish `poll_choice`, and hand `next_event`'s requests to the TM/TC end of the
    ground. Pass the sender's confirmations to `handle_confirmed`. Do so again at `poll_timeout`.

    A telecommand is completed when the sender has confirmed the choice that it led to. From then on
    nothing of another camera is coded or sent. Either process may be killed at any time. A new
    selector numbers its choice anew, and the repeated telecommand waits for that number. A new
    sender confirms the first choice that it hears. A choice is told repeatedly, for a sender that
    starts late.

    A focus is a part of the selected camera's picture; with another camera there is none.

    cameras: their names. kept: what `kept` had in an earlier start, or "".
    """

    def __init__(
        self, cameras: Sequence[str], probe: Probe, *, now_ns: int, kept: str = ""
    ) -> None:
        self._cameras = tuple(cameras)
        self._probe = probe
        camera, _, focus = kept.partition(" ")
        self.selected = camera if camera in cameras else cameras[0]
        self.focus = Focus.parse(focus or "off")
        self._focuses: deque[DatedEvent] = deque(maxlen=_MOST_KEPT)
        self._switches = 0
        #: The clock never goes back: a restarted selector's first number is above all before.
        self._number = now_ns
        self._confirmed: int | None = None
        self._told_ns: int | None = None
        #: Telecommands that wait for the present choice.
        self._open: deque[FunctionAsked] = deque(maxlen=_MOST_OPEN)
        #: What the sender has confirmed.
        self._followed: tuple[str, Focus | None] = "", None
        self._requests: deque[FunctionDone | SetValues | RaiseEvent] = deque()

    @property
    def kept(self) -> str:
        """Camera and focus, for a next start."""
        return f"{self.selected} {self.focus or 'off'}"

    def handle_asked(self, asked: FunctionAsked, now_ns: int) -> bool:
        """A telecommand has come, also one for another application; True if `kept` changes."""
        if asked.application != CAMERA or asked.function not in (SELECT, FOCUS):
            return False
        if asked.function == FOCUS:
            return self._handle_focus(asked, now_ns)
        name = str(asked.arguments[0])
        if name not in self._cameras:
            known = ", ".join(self._cameras)
            self._answer(asked, f"unknown camera {name}: choose one of {known}")
            return False
        changed = self.select(name, now_ns)
        self._open.append(asked)
        self._complete()
        return changed

    def select(self, name: str, now_ns: int) -> bool:
        """The ground selects a camera; True if it is a known one, and another than before."""
        if name not in self._cameras or name == self.selected:
            return False
        while self._open:
            self._answer(self._open.popleft(), _SUPERSEDED)
        self.selected = name
        self._switches += 1
        self._turn_to(None, f"camera {name}", now_ns)
        return True

    def _handle_focus(self, asked: FunctionAsked, now_ns: int) -> bool:
        try:
            focus = Focus.parse(str(asked.arguments[0]))
        except ConfigError as error:
            self._answer(asked, str(error))
            return False
        changed = focus != self.focus
        if changed:
            self._turn_to(focus, f"asked from {asked.origin}", now_ns)
        self._open.append(asked)
        self._complete()
        return changed

    def _turn_to(self, focus: Focus | None, why: str, now_ns: int) -> None:
        """The choice is another one, with this focus."""
        if focus != self.focus:
            self.focus = focus
            words = f"focus {focus or 'off'}: {why}"
            self._focuses.append(DatedEvent(at_ns=now_ns, what=words))
        self._number = max(now_ns, self._number + 1)
        self._told_ns = None

    def handle_confirmed(self, number: int) -> None:
        """The sender has confirmed a choice: nothing of an earlier camera is coded or sent."""
        self._confirmed = number
        self._complete()

    def poll_choice(self, now_ns: int) -> Choice | None:
        """What the sender has to know, if it is to be told now."""
        if self._told_ns is not None and now_ns - self._told_ns < AGAIN_NS:
            return None
        self._told_ns = now_ns
        return Choice(self._number, self.selected, self.focus)

    def poll_timeout(self) -> int:
        """When `poll_choice` has something; 0 for at once."""
        return 0 if self._told_ns is None else self._told_ns + AGAIN_NS

    def next_event(self) -> FunctionDone | SetValues | RaiseEvent | None:
        """Return the next request for the TM/TC end, or None."""
        return self._requests.popleft() if self._requests else None

    def _complete(self) -> None:
        if self._confirmed is None or self._confirmed < self._number:
            return
        (camera, focus), self._followed = self._followed, (self.selected, self.focus)
        if self.selected != camera:
            self._requests.append(SetValues(CAMERA, {CAMERA: self.selected}))
        if self.focus != focus:
            self._requests.append(SetValues(CAMERA, {FOCUS: str(self.focus or "off")}))
            self._requests.append(RaiseEvent(CAMERA, "focus_changed"))
        while self._open:
            self._answer(self._open.popleft(), "")

    def _answer(self, asked: FunctionAsked, refusal: str) -> None:
        self._requests.append(FunctionDone(CAMERA, asked.token, refusal))

    def publish(self) -> None:
        """Put the counters into the probe."""
        self._probe.publish(
            SelectorMetrics(
                selected=self.selected,
                switches=self._switches,
                focus=str(self.focus or "off"),
                focuses=tuple(self._focuses),
            )
        )
