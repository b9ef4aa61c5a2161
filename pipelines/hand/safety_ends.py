"""What robot and joystick do about orders that outlive a process: emergency stop, halt, power.

And whether what the operator sees is too old to move a robot by.
"""

from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace

from kontur_av.clock import NS_PER_S
from kontur_av.sources.stereo import HALF
from kontur_av.streams.lipsync import LAG
from kontur_av.streams.staleness import FUTURE_NS
from kontur_av.topics.bus import TopicBus
from pipelines.hand.desks import RobotDesk
from pipelines.hand.hand_topics import JoystickOrders, RobotOrders
from pipelines.hand.haptic_loop import Cycle
from pipelines.hand.haptics import RobotEnd
from pipelines.media.following import Choice
from pipelines.session.kept_files import KeptOrders
from pipelines.session.setup.table import STEREO, Setup
from pipelines.session.topology import HALVES_TOPIC, JOYSTICK, ROBOT, SELECTED_TOPIC, Topology
from telepresence.haptics.device.handle import OperatedHandle
from telepresence.haptics.envelope import Hold, SafetyLimits
from telepresence.haptics.robot import RobotFacts
from telepresence.tasks.definitions import ControlMode


class OperatorView:
    """The age of the uplink's picture where it is shown.

    A display that shows nothing, or is gone, lets the last picture age. Before the first picture
    everything is too old.
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

    def is_blind(self, now_ns: int) -> bool:
        """Whether the picture is too old, or there is none."""
        return self._captured_ns is None or now_ns - self._captured_ns > self._most_ns


class CameraWatch:
    """At the robot: a change of the selected camera, and the frozen half of a merged picture.

    `changed` is called at each change but the first.
    """

    def __init__(self, merged: str, stale_ns: int, changed: Callable[[], None]) -> None:
        self._merged, self._stale_ns, self._changed = merged, stale_ns, changed
        self._camera: str | None = None
        self._captured_ns: int | None = None

    def handle_choice(self, camera: str) -> None:
        if self._camera is not None and camera != self._camera:
            self._changed()
        self._camera = camera

    def handle_halves(self, captured_ns: int) -> None:
        """The older half of the newest merged picture was captured then."""
        self._captured_ns = captured_ns

    def is_blind(self, now_ns: int) -> bool:
        """Whether the operator looks at a merged picture of which a half is too old."""
        if self._camera != self._merged or self._captured_ns is None:
            return False
        return now_ns - self._captured_ns > self._stale_ns


#: Of a robot that does not know what was ordered, and of such a joystick.
UNKNOWN_ROBOT = RobotOrders(powered=False, mode=ControlMode.TELEPRESENCE.value)
UNKNOWN_JOYSTICK = JoystickOrders(paused=True)


def within(limits: SafetyLimits, facts: RobotFacts | None) -> SafetyLimits:
    """Return a setup's limits, where a user's robot has less its own."""
    if facts is None:
        return limits
    speed_m_s = min(limits.speed_m_s, facts.speed_m_s)
    return replace(
        limits,
        speed_m_s=speed_m_s,
        approach_m_s=min(limits.approach_m_s, speed_m_s),
        slow_m_s=min(limits.slow_m_s, speed_m_s),
        force_n=min(limits.force_n, facts.force_limit_n),
        half_width_m=min(limits.half_width_m, facts.half_width_m),
        half_height_m=min(limits.half_height_m, facts.half_height_m),
    )


def follow_stop(kept: KeptOrders, end: RobotEnd) -> Cycle:
    """Return what joins the robot's emergency stop with the one that the machine keeps."""
    envelope = end.envelope
    known = False

    def follow(now_ns: int) -> None:
        nonlocal known
        ordered = kept.stopped
        if ordered and not known:
            envelope.handle_stop(now_ns)
        elif known and not ordered:
            envelope.handle_stop_released(now_ns)
        elif envelope.stopped and not ordered:
            # A stop that cannot be kept holds in this process, and is tried again.
            with suppress(OSError):
                kept.stop("the joystick or a telecommand")
                ordered = True
        elif ordered and not envelope.stopped:
            # By a telecommand.
            kept.release()
            ordered = False
        known = ordered

    return follow


def keep_robot(kept: KeptOrders, desk: RobotDesk) -> Cycle:
    """Return what keeps power and mode of the robot."""
    last = desk.orders
    # Once the disk is full, a file that exists can still be emptied.
    kept.keep(ROBOT, last)

    def keep(_now_ns: int) -> None:
        nonlocal last
        orders = desk.orders
        if orders != last:
            last = orders
            kept.keep(ROBOT, orders)

    return keep


def keep_joystick(kept: KeptOrders, handle: OperatedHandle) -> Cycle:
    """Return what keeps a person's orders, and puts the emergency stop into every sample."""
    operation = handle.operation
    last = JoystickOrders(paused=operation.paused, experiment=operation.experiment)
    kept.keep(JOYSTICK, last)

    def keep(_now_ns: int) -> None:
        nonlocal last
        handle.stop = kept.stopped
        orders = JoystickOrders(paused=operation.paused, experiment=operation.experiment)
        if orders != last:
            last = orders
            kept.keep(JOYSTICK, orders)

    return keep


def look_at_picture(bus: TopicBus, topology: Topology, handle: OperatedHandle) -> Cycle:
    """Return what tells the robot, in every sample, that the operator's picture is too old."""
    setup = topology.setup
    view = OperatorView(setup)
    reader = bus.reader(topology.video(setup.uplink_video.name).lag_topic)

    def look(now_ns: int) -> None:
        if (lag := reader.latest_octets()) is not None:
            view.handle_shown(*LAG.unpack(lag))
        handle.blind = view.is_blind(now_ns)

    return look


def watch_camera(bus: TopicBus, setup: Setup, end: RobotEnd) -> Cycle:
    """Return what holds the robot at a change of the camera, and at half a frozen picture."""
    envelope = end.envelope
    stale_ns = setup.stale_after_ns(setup.uplink_video)
    watch = CameraWatch(STEREO, stale_ns, lambda: envelope.require_press(Hold.CAMERA))
    choices = bus.reader(SELECTED_TOPIC)
    halves = bus.reader(HALVES_TOPIC) if STEREO in setup.cameras else None

    def look(now_ns: int) -> None:
        if (choice := choices.latest_octets()) is not None:
            watch.handle_choice(Choice.unpack(choice).camera)
        if halves is not None and (half := halves.latest_octets()) is not None:
            watch.handle_halves(HALF.unpack(half)[0])
        envelope.blind = watch.is_blind(now_ns)

    return look
