"""A policy's program in a session: what it sees, at a rate of its own, and what it wants."""

import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

from kontur_av.clock import NS_PER_MS, NS_PER_S, MonotonicClock
from kontur_av.closing import Closing
from kontur_av.errors import ConfigError
from kontur_av.returned import fault_of, one_line
from kontur_av.topics.bus import TopicBus
from pipelines.hand.hand_topics import DRIVER_TOPIC, POLICY_TOPIC, DriverState
from pipelines.session.mission_messages import MISSION_PANEL_TOPIC, ROBOT_STATUS_TOPIC, PanelShown
from pipelines.session.sessions import is_alive
from pipelines.session.topic_ends import TopicReader, TopicWriter
from telepresence.haptics.device.page import NO_PICTURE
from telepresence.haptics.device.policy import PolicyMessage, taken_action

if TYPE_CHECKING:
    from pipelines.mission.joined_session import ShownPicture, TopicFeed

_OPENING_NS = 5 * NS_PER_S
_LOOK_NS = 10 * NS_PER_MS
#: A newest action counts for so long, as a hand's newest command does (`hand_max_age_s`).
_LEAST_KEEP_NS, _MOST_KEEP_NS = 500 * NS_PER_MS, NS_PER_S


@dataclass(frozen=True, kw_only=True, slots=True)
class Observation:
    """What the operator has, at `now_ns` of the monotonic clock.

    axes: the robot's, in the order of an action. robot: the place of each, m or rad; push: of its
    surroundings on those behind x and y, N or N m; push_n: on the tip along x and y.
    picture: the newest on the display, None before the first. task: what the panel shows, None in a
    session without tasks. drives: the policy has the handle; who: who has it, "" for nobody.
    hold: why the robot follows no hand, in words.
    """

    now_ns: int
    axes: tuple[str, ...]
    robot: Mapping[str, float]
    push: Mapping[str, float]
    push_n: float
    hold: str
    picture: "ShownPicture | None"
    task: PanelShown | None
    drives: bool
    who: str


class Policy(Protocol):
    """What `JoinedSession.drive` calls."""

    def step(self, observation: Observation) -> Any:
        """Return where the robot is to be: an action, a chunk, or None, which lets go.

        As `telepresence.haptics.device.policy.taken_action` takes it.
        """


class Driving(Closing):
    """The place of a policy's program. Call `observe`, then `act`, at `hz`, with `wait` between.

    name: of the policy. shadow: its commands are recorded, and never obeyed.
    fault: why its newest step failed, in one line. axes: the robot's.

    Raises ConfigError where no page moves the joystick, or the robot is on another machine.
    """

    def __init__(
        self,
        session: str,
        pictures: "TopicFeed[ShownPicture]",
        *,
        name: str,
        hz: float,
        shadow: bool,
    ) -> None:
        if not 0.5 <= hz <= 200.0:
            raise ConfigError(f"hz is {hz:g}: take 0.5 to 200")
        self._session, self.name, self._shadow = session, one_line(name), shadow
        self.period_ns = round(NS_PER_S / hz)
        self.fault = ""
        self._clock, self._bus = MonotonicClock(), TopicBus.join(session)
        self._writer = TopicWriter(self._bus, POLICY_TOPIC, wake=True)
        self._driver, self._robot = (
            TopicReader(self._bus, DRIVER_TOPIC),
            TopicReader(self._bus, ROBOT_STATUS_TOPIC),
        )
        tasks = MISSION_PANEL_TOPIC in self._bus.topics()
        self._panel = TopicReader(self._bus, MISSION_PANEL_TOPIC, opened=tasks)
        self._pictures = pictures
        self._picture: ShownPicture | None = None
        self._seen: tuple[tuple[float, ...], int] = ((), 0)
        until_ns = self._clock.now_ns() + _OPENING_NS
        while not self._look() and self._clock.now_ns() < until_ns:
            self._clock.sleep_until_ns(self._clock.now_ns() + _LOOK_NS)
        if self._driver.newest is None or self._robot.newest is None:
            self._bus.close()
            raise ConfigError(
                f"session {session} tells no place of handle or robot: start it with --joystick "
                "page, and the policy where the robot is"
            )
        self.axes = self._driver.newest.axes
        self._observed_ns = self._due_ns = self._clock.now_ns()

    def observe(self) -> Observation:
        """Return what the operator has now."""
        self._look()
        driver, robot = self._driver.newest or DriverState(), self._robot.newest
        assert robot is not None
        self._observed_ns = self._clock.now_ns()
        push = {name: push for name, _, push in robot.axes}
        places = {"x": robot.x_m, "y": robot.y_m} | {name: at for name, at, _ in robot.axes}
        places = {name: places[name] for name in self.axes}
        self._seen = tuple(places.values()), self._robot.newest_ns
        return Observation(
            now_ns=self._observed_ns,
            axes=self.axes,
            robot=places,
            push=push,
            push_n=robot.push_n,
            hold=robot.hold,
            picture=self._picture,
            task=self._panel.newest,
            drives=driver.drives,
            who=driver.who,
        )

    def act(self, returned: Any) -> None:
        """Say where the robot is to be, as a `Policy` returns it. Raises PartError for nonsense."""
        self._say(taken_action(returned, self.axes, self.period_ns / NS_PER_S) or [])

    def fail(self, fault: str) -> None:
        """The step has failed: let go, and say why once."""
        self._say((), fault)
        if fault != self.fault:
            print(f"kontur-av: policy {self.name}: {fault}", file=sys.stderr, flush=True)
        self.fault = fault

    def step(self, step: Callable[[Observation], Any]) -> None:
        """Observe, call `step`, act: whatever it returns or raises, the session goes on."""
        observation = self.observe()
        try:
            self.act(step(observation))
        except Exception as error:
            self.fail(fault_of("step()", error))

    def wait(self) -> bool:
        """Wait for the next period; return False once the session has ended."""
        now_ns = self._clock.now_ns()
        self._due_ns = max(self._due_ns + self.period_ns, now_ns)
        self._clock.sleep_until_ns(self._due_ns)
        return is_alive(self._session)

    def close(self) -> None:
        """Let go, and leave the session."""
        if is_alive(self._session):
            self._say((), "its program has ended")
        self._bus.close()

    def _look(self) -> bool:
        """Read what is new; return whether handle and robot are known."""
        self._driver.latest(), self._robot.latest(), self._panel.latest()
        self._picture = self._pictures.latest() or self._picture
        return self._driver.newest is not None and self._robot.newest is not None

    def _say(self, chunk: Any, fault: str = "") -> None:
        now_ns, (seen, seen_ns) = self._clock.now_ns(), self._seen
        times_ns = tuple(self._observed_ns + round(ahead_s * NS_PER_S) for ahead_s, _ in chunk)
        keep_ns = min(max(3 * self.period_ns, _LEAST_KEEP_NS), _MOST_KEEP_NS)
        # The time that the step took is no silence.
        keep_ns += max(0, now_ns - times_ns[-1]) if times_ns else 0
        picture_ns = NO_PICTURE if self._picture is None else self._picture.captured_ns
        message = PolicyMessage(
            name=self.name,
            seen=seen,
            seen_ns=seen_ns,
            times_ns=times_ns,
            places=tuple(place for _, place in chunk),
            keep_ns=min(keep_ns, 2 * _MOST_KEEP_NS),
            picture_ns=picture_ns,
            shadow=self._shadow,
            fault=fault,
        )
        self._writer.publish(message, now_ns)
