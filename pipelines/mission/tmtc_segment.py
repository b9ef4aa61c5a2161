"""A segment's end of telecommands and telemetry, with what feeds and obeys it. A core."""

from collections.abc import Callable, Sequence

from pipelines.hand.hand_topics import HandRequest, JoystickStatus
from pipelines.hand.knowledge import EndKnowledge, EndTraits
from pipelines.link.link_metrics import CONNECTED
from pipelines.mission.supervisor import ProcessSupervisor, session_dictionary
from pipelines.mission.tmtc import TmtcEnd
from pipelines.mission.tmtc_messages import FunctionAsked, TmtcNews, Values
from pipelines.mission.tmtc_sources import (
    GatewaySource,
    JoystickSource,
    RobotSource,
    SituationSource,
)
from pipelines.session.mission_messages import RobotCommand, RobotStatus
from pipelines.session.session_metrics import ProcessNow
from pipelines.session.setup.segments import Segment
from pipelines.session.topology.table import Topology
from telepresence.tmtc.pus.dictionary import Dictionary

#: What joystick or robot is asked for.
HandCommand = HandRequest | RobotCommand


class TmtcSegment:
    """The applications of a segment: gateway, joystick or robot, and the supervisor of processes.

    Hand over packets and requests to `end`, what panel and experiment show to `knowledge`, all
    else to the methods. Then send `end.poll_transmit`, and take `next_event` until None. Order
    `poll_order` of the launcher.

    dictionary: the built-in one. first_number: above those of an earlier life; other arguments as
    of `TmtcEnd`.

    robot: the source of its state, on the ground. situation: what may be done now at this end.
    """

    def __init__(
        self,
        segment: Segment,
        topology: Topology,
        dictionary: Dictionary,
        *,
        now_ns: int,
        first_number: int,
        first_count: int,
        boot_id: int,
        epoch_ns: int = 0,
    ) -> None:
        self.dictionary = session_dictionary(dictionary, topology)
        self.end = end = TmtcEnd(
            segment,
            self.dictionary,
            now_ns=now_ns,
            first_count=first_count,
            boot_id=boot_id,
            epoch_ns=epoch_ns,
            routes=topology.options.routes,
            delay_ns=topology.setup.radio_profile.longest_delay_ns,
        )
        self._supervisor = ProcessSupervisor(segment, topology)
        self.poll_order = self._supervisor.poll_transmit
        self._gateway = GatewaySource(end, f"{segment.value}_gateway")
        self.knowledge = EndKnowledge(EndTraits.of(topology, segment))
        self.situation = SituationSource(end, self.knowledge, segment)
        self._joystick = self.robot = None
        self._request: Callable[[FunctionAsked, int], HandCommand | None]
        if segment is Segment.SPACE:
            self._joystick = JoystickSource(end, first_number=first_number)
            self._request = self._joystick.handle_asked
        else:
            self.robot = RobotSource(end, first_number=first_number)
            self._request = self.robot.handle_asked

    def handle_link(self, values: Values, now_ns: int) -> None:
        """What the gateway of this segment tells."""
        self._gateway.handle_values(values, now_ns)
        self.situation.connected = values.get("state") == CONNECTED and bool(values.get("signal"))

    def handle_status(self, status: JoystickStatus | RobotStatus, now_ns: int) -> None:
        """What the joystick or the robot of this segment tells."""
        self.knowledge.handle_told(status, now_ns)
        if isinstance(status, RobotStatus):
            if self.robot is not None:
                self.robot.handle_status(status, now_ns)
        elif self._joystick is not None:
            self._joystick.handle_status(status, now_ns)

    def handle_processes(self, states: Sequence[ProcessNow], now_ns: int) -> None:
        """What the launcher says of the processes of this machine."""
        self._supervisor.handle_told(states, now_ns)
        self._settle(now_ns)

    def handle_refused(self, process: str, reason: str, now_ns: int) -> None:
        """The launcher does not carry out an order."""
        self._supervisor.handle_refused(process, reason)
        self._settle(now_ns)

    def next_event(self, now_ns: int) -> tuple[TmtcNews, HandCommand | None] | None:
        """Return the next news, and what joystick or robot is asked for by it; or None."""
        news = self.end.next_event()
        if not isinstance(news, FunctionAsked):
            return None if news is None else (news, None)
        self._supervisor.handle_asked(news)
        self._settle(now_ns)
        return news, self._request(news, now_ns)

    def _settle(self, now_ns: int) -> None:
        while (request := self._supervisor.next_event()) is not None:
            self.end.handle_request(request, now_ns)
