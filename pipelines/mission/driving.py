"""A policy's program in a session: what it sees, at a rate of its own, and what it wants."""

import os
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from kontur_av.clock import NS_PER_MS, NS_PER_S, MonotonicClock
from kontur_av.closing import Closing
from kontur_av.errors import ConfigError
from kontur_av.returned import fault_of
from kontur_av.topics.bus import TopicBus
from pipelines.hand.hand_topics import DRIVER_TOPIC, POLICY_TOPIC, DriverState
from pipelines.session.mission_messages import MISSION_PANEL_TOPIC, ROBOT_STATUS_TOPIC, PanelShown
from pipelines.session.sessions import is_alive
from pipelines.session.topic_ends import TopicReader, TopicWriter
from telepresence.haptics.device.page import NO_PICTURE
from telepresence.haptics.device.policy import PolicyMessage, taken_action

if TYPE_CHECKING:
    from pipelines.mission.joined_session import JoinedSession, ShownPicture

_OPENING_NS = 10 * NS_PER_S
#: The newest action counts for so long, as a hand's newest command does (`hand_max_age_s`).
_KEEP_NS = 500 * NS_PER_MS


@dataclass(frozen=True, kw_only=True, slots=True)
class Observation:
    """What the operator has, at `now_ns` of the monotonic clock.

    robot: the place of each axis, m or rad. push_n: of its surroundings on the tip, along x and y.
    hold: why it follows no hand, in words. drives: the policy has the handle. picture: the newest
    on the display, None before the first. task: what the panel shows, None without tasks.
    """

    now_ns: int
    robot: Mapping[str, float]
    push_n: float
    hold: str
    drives: bool
    picture: "ShownPicture | None"
    task: PanelShown | None


class Driving(Closing):
    """The place of a policy's program in a session: `step`, `wait`; or `observe`, then `act`.

    name: of the policy. hz: of its steps. shadow: its commands are recorded, and never obeyed.
    Raises ConfigError where the session serves no pages, or the robot is on another machine.
    """

    def __init__(
        self, session: "JoinedSession", name: str, *, hz: float = 20.0, shadow: bool = False
    ) -> None:
        if not 1.0 <= hz <= 200.0:
            raise ConfigError(f"hz is {hz:g}: take 1 to 200")
        self.name, self._session, self._shadow = name, session.name, shadow
        self._period_ns, self._clock = round(NS_PER_S / hz), MonotonicClock()
        self._pictures = session.pictures()
        self._picture: ShownPicture | None = None
        self._bus = bus = TopicBus.join(session.name)
        try:
            self._writer = TopicWriter(bus, POLICY_TOPIC, wake=True)
        except Exception as error:
            bus.close()
            raise ConfigError(f"session {session.name} takes no policy: {error}") from None
        self._driver, self._robot = (
            TopicReader(bus, DRIVER_TOPIC),
            TopicReader(bus, ROBOT_STATUS_TOPIC),
        )
        tasks = MISSION_PANEL_TOPIC in bus.topics()
        self._panel = TopicReader(bus, MISSION_PANEL_TOPIC, opened=tasks)
        self._due_ns = self._clock.now_ns()
        until_ns = self._due_ns + _OPENING_NS
        driver, robot = self._driver, self._robot
        while not (
            (driver.latest() or driver.newest or DriverState()).axes
            and (robot.latest() or robot.newest)
        ):
            if self._due_ns > until_ns or not self.wait():
                bus.close()
                raise ConfigError(
                    "it has no operator's page, or the robot is elsewhere: start the "
                    "session without --no-page, and the policy beside the robot"
                )
        self._fault, self._rest = "", dict[str, float]()
        self.observe()

    def observe(self) -> Observation:
        """Return what the operator has now."""
        self._driver.latest(), self._robot.latest(), self._panel.latest()
        driver, robot = self._driver.newest, self._robot.newest
        assert driver is not None and robot is not None
        self._picture = self._pictures.latest() or self._picture
        places = {"x": robot.x_m, "y": robot.y_m} | {name: at for name, at, _ in robot.axes}
        seen = {name: places[name] for name in driver.axes}
        self._seen = tuple(seen.values()), self._robot.newest_ns
        if not driver.drives:
            self._rest = seen
        self._observed_ns = self._clock.now_ns()
        return Observation(
            now_ns=self._observed_ns,
            robot=seen,
            push_n=robot.push_n,
            hold=robot.hold,
            drives=driver.drives,
            picture=self._picture,
            task=self._panel.newest,
        )

    def act(self, returned: Any, fault: str = "") -> None:
        """Say where the robot is to be, as `taken_action` takes it. PartError for nonsense."""
        chunk = taken_action(returned, self._rest, self._period_ns / NS_PER_S)
        times_ns = [self._observed_ns + round(ahead_s * NS_PER_S) for ahead_s, _ in chunk]
        if chunk:
            self._rest = dict(zip(self._rest, chunk[-1][1], strict=True))
        now_ns = self._clock.now_ns()
        message = PolicyMessage(
            self.name,
            os.getpid(),
            *self._seen,
            tuple(times_ns),
            tuple(place for _, place in chunk),
            max([now_ns, *times_ns]) + max(_KEEP_NS, 2 * self._period_ns),
            NO_PICTURE if self._picture is None else self._picture.captured_ns,
            self._shadow,
            fault,
        )
        self._writer.publish(message, now_ns)

    def step(self, step: Callable[[Observation], Any]) -> None:
        """Observe, call `step`, act: whatever it returns or raises, the session goes on."""
        try:
            self.act(step(self.observe()))
        except Exception as error:
            fault = fault_of("step()", error)
            self.act(None, fault)
            if fault != self._fault:
                print(f"kontur-av: policy {self.name}: {fault}", file=sys.stderr, flush=True)
            self._fault = fault

    def wait(self) -> bool:
        """Wait for the next period; return False once the session has ended."""
        self._due_ns = max(self._due_ns + self._period_ns, self._clock.now_ns())
        self._clock.sleep_until_ns(self._due_ns)
        return is_alive(self._session)

    def close(self) -> None:
        """Let go, and leave the session."""
        if is_alive(self._session):
            self.act(None, "its program has ended")
        self._bus.close()
