"""What robot and joystick do about orders that outlive a process: emergency stop, halt, power.

And whether what the operator sees is too old to move a robot by.
"""

from contextlib import suppress
from dataclasses import replace

from kontur_av.clock import NS_PER_MS, NS_PER_S, MonotonicClock
from kontur_av.streams.staleness import FUTURE_NS
from kontur_av.topics.bus import TopicBus
from pipelines.hand.hand_topics import JOYSTICK_STATE_TOPIC, JoystickOrders, RobotOrders
from pipelines.session.kept_files import KeptOrders
from pipelines.session.mission_messages import ROBOT_STATUS_TOPIC
from pipelines.session.setup.table import Setup
from pipelines.session.topic_ends import TopicReader
from telepresence.haptics.device.page import NO_PICTURE
from telepresence.haptics.envelope import Hold, SafetyEnvelope, SafetyLimits
from telepresence.haptics.robot import RobotCapabilities
from telepresence.tasks.definitions import ControlMode


class OperatorView:
    """The age of the uplink's picture where it is shown.

    A display that shows nothing, or is gone, lets the last picture age. Before the first picture
    everything is too old. Where a page steers, the picture that it has painted counts, too.
    """

    def __init__(self, setup: Setup) -> None:
        granted_ns = round(setup.safety.picture_max_age_s * NS_PER_S)
        self._most_ns = setup.stale_after_ns(setup.uplink_video) + granted_ns
        self._captured_ns: int | None = None

    def handle_shown(self, shown_ns: int, lag_ns: int) -> None:
        """A picture was shown at `shown_ns`, `lag_ns` after it was captured.

        One from the future has an age that nobody knows.
        """
        self._captured_ns = shown_ns - lag_ns if lag_ns >= -FUTURE_NS else None

    def is_blind(self, now_ns: int, painted_ns: int = NO_PICTURE) -> bool:
        """Whether the picture is too old, or there is none.

        painted_ns: as `PageInput.picture_ns` has it, of the page that steers.
        """
        captured_ns = self._captured_ns
        if captured_ns is not None and painted_ns != NO_PICTURE:
            captured_ns = min(captured_ns, painted_ns)
        return captured_ns is None or now_ns - captured_ns > self._most_ns


class CameraWatch:
    """At the robot: a change of the selected camera, and the frozen part of a composed picture.

    A change needs a new press. Call `handle_time` every few cycles.
    """

    def __init__(self, setup: Setup, envelope: SafetyEnvelope) -> None:
        self._stale_ns = setup.stale_after_ns(setup.uplink_video)
        self._envelope = envelope
        self._camera: str | None = None
        #: By composed camera.
        self._captured_ns: dict[str | None, int] = {}

    def handle_choice(self, camera: str) -> None:
        if self._camera is not None and camera != self._camera:
            self._envelope.require_press(Hold.CAMERA)
        self._camera = camera

    def handle_oldest(self, camera: str, captured_ns: int) -> None:
        """The older part of the newest picture of a composed camera was captured then."""
        self._captured_ns[camera] = captured_ns

    def handle_time(self, now_ns: int) -> None:
        """Tell whether the operator looks at a composed picture of which a part is too old."""
        captured_ns = self._captured_ns.get(self._camera)
        self._envelope.blind = captured_ns is not None and now_ns - captured_ns > self._stale_ns


#: A repeated stop clears the bit for `_PULSE_NS` every `_EVERY_NS`. It does so for `_LEAST_NS`, and
#: then until the robot says that it is stopped, for `_ASKS_NS` at most.
_PULSE_NS, _EVERY_NS, _LEAST_NS, _ASKS_NS = (each * NS_PER_MS for each in (50, 200, 600, 10_000))


class StopBit:
    """Whether the joystick's samples carry the emergency stop.

    A robot whose stop was released elsewhere follows no hand while the bit stays set. Only a change
    of the bit is a new order for it. So a repeated stop clears the bit for a moment.
    """

    def __init__(self) -> None:
        self._ordered_ns = self._began_ns = 0
        self._asks = False

    def handle_order(self, ordered_ns: int | None, robot_stopped: bool, now_ns: int) -> bool:
        """Return the bit. ordered_ns: names the newest order; None: no stop holds here.

        robot_stopped: its newest sample says so.
        """
        if ordered_ns is None:
            self._ordered_ns, self._asks = 0, False
            return False
        if ordered_ns != self._ordered_ns:
            self._asks, self._began_ns = self._ordered_ns != 0, now_ns
            self._ordered_ns = ordered_ns
        lasts_ns = now_ns - self._began_ns
        if lasts_ns >= _LEAST_NS and (robot_stopped or lasts_ns >= _ASKS_NS):
            self._asks = False
        return not (self._asks and lasts_ns % _EVERY_NS < _PULSE_NS)


#: Of a robot that does not know what was ordered, and of such a joystick.
UNKNOWN_ROBOT = RobotOrders(powered=False, mode=ControlMode.TELEPRESENCE.value)
UNKNOWN_JOYSTICK = JoystickOrders(paused="halt: it is not known what was ordered before a restart")


def within(limits: SafetyLimits, capabilities: RobotCapabilities | None) -> SafetyLimits:
    """Return a setup's limits, where a user's robot has less its own."""
    if capabilities is None:
        return limits
    speed_m_s = min(limits.speed_m_s, capabilities.speed_m_s)
    return replace(
        limits,
        speed_m_s=speed_m_s,
        approach_m_s=min(limits.approach_m_s, speed_m_s),
        slow_m_s=min(limits.slow_m_s, speed_m_s),
        force_n=min(limits.force_n, capabilities.force_limit_n),
        half_width_m=min(limits.half_width_m, capabilities.half_width_m),
        half_height_m=min(limits.half_height_m, capabilities.half_height_m),
    )


class FollowedStop:
    """The robot's emergency stop, joined with the one that the machine keeps."""

    def __init__(self, kept: KeptOrders, envelope: SafetyEnvelope) -> None:
        self._kept, self._envelope = kept, envelope
        self._known = False

    def follow(self, now_ns: int) -> None:
        kept, envelope = self._kept, self._envelope
        ordered = kept.stopped
        if ordered and not self._known:
            envelope.handle_stop(now_ns, kept.stopped_by)
        elif self._known and not ordered:
            envelope.handle_stop_released(now_ns, kept.released_by)
        elif envelope.stopped and not ordered:
            # A stop that cannot be kept holds in this process, and is tried again.
            with suppress(OSError):
                kept.stop(envelope.stopped_by)
                ordered = True
        elif ordered and not envelope.stopped:
            # By a telecommand.
            kept.release("a telecommand")
            ordered = False
        self._known = ordered


#: How long the robot may take to answer a stop here, and across the radio.
_HERE_NS, _ACROSS_NS = NS_PER_S, 4 * NS_PER_S
_LOOK_NS = 10 * NS_PER_MS


def await_stopped(session: str, ordered_ns: int, *, stopped: bool = True) -> str:
    """Wait until the robot answers a stop; return "", or that it does not, in words.

    ordered_ns: when it was ordered, on this machine's monotonic clock. stopped: False for a release
    on the robot's machine.
    """
    clock = MonotonicClock()
    with TopicBus(session) as bus:
        robot = TopicReader(bus, ROBOT_STATUS_TOPIC)
        joystick = TopicReader(bus, JOYSTICK_STATE_TOPIC)
        # Opening them may take seconds on a busy machine.
        began_ns, status = clock.now_ns(), None
        while (waited_ns := clock.now_ns() - began_ns) < _ACROSS_NS:
            status = robot.latest() or robot.newest
            if status is not None and robot.newest_ns >= ordered_ns:
                # A joystick's own stop must be released, too.
                answered = status.stopped if stopped else not status.stopped_by
                if answered:
                    return ""
            held = joystick.latest()
            if status is None and held is not None and held.robot_stopped and stopped:
                return ""
            if status is not None and waited_ns >= _HERE_NS:
                # It is on this machine.
                break
            clock.sleep_until_ns(clock.now_ns() + _LOOK_NS)
        since_ns = clock.now_ns() - (robot.newest_ns or ordered_ns)
    if status is not None and not (stopped or status.stopped) and since_ns < _HERE_NS:
        return f"{status.stopped_by} orders the stop, too: release it there"
    seconds = f"{since_ns / NS_PER_S:.1f} s"
    return f"the robot has not answered for {seconds}: look at it, and take its power there"
