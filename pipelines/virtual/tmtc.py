"""PUS of both segments on virtual time."""

from collections.abc import Callable, Mapping
from functools import partial
from random import Random

from kontur_av.clock import NS_PER_S
from pipelines.hand.hand_topics import JoystickStatus, unpack_status
from pipelines.hand.joystick_status import JoystickStatusTeller
from pipelines.hand.robot_desk import RobotDesk
from pipelines.link.link_state import link_values
from pipelines.mission.choosing import session_dictionary
from pipelines.mission.tmtc import TmtcEnd
from pipelines.mission.tmtc_messages import FunctionAsked, TmtcNews, TmtcRequest
from pipelines.mission.tmtc_sources import SAMPLE_NS, GatewaySource, JoystickSource, RobotSource
from pipelines.session.setup.segments import Segment
from pipelines.session.setup.table import Setup
from pipelines.virtual.agenda import Agenda, Timer
from telepresence.haptics.bilateral import Handle
from telepresence.haptics.device.handle import OperatedHandle
from telepresence.haptics.joystick import Joystick
from telepresence.link.gateway import Gateway
from telepresence.tmtc.pus.dictionary_file import built_in_dictionary
from telepresence.tmtc.pus.packets import COUNT_MODULUS
from telepresence.world import WorldState

#: Takes news of a segment, with the instant.
TakeNews = Callable[[TmtcNews, int], object]


class SimulatedTmtc:
    """The TM/TC ends of a simulation, by segment.

    send: gives a packet of a segment to its gateway. state_at: the newest state of the robot.
    robot: its controller; None: there is none, and nobody carries out its functions.
    handle: of the joystick; None: there is none, and nobody carries out its functions.
    silent: send nothing, because a recording has the packets.
    """

    def __init__(
        self,
        setup: Setup,
        agenda: Agenda,
        *,
        send: Mapping[Segment, Callable[[bytes, int], object]],
        gateways: Mapping[Segment, Gateway],
        state_at: Callable[[int], WorldState],
        robot: RobotDesk | None,
        handle: Handle | None,
        random: Random,
        now_ns: int,
        silent: bool = False,
    ) -> None:
        self._agenda = agenda
        self._send = send
        self._gateways = gateways
        self._state_at = state_at
        self._handle = handle
        self._silent = silent
        self._takers: dict[Segment, list[TakeNews]] = {segment: [] for segment in Segment}
        self.ends = {
            segment: TmtcEnd(
                segment,
                session_dictionary(built_in_dictionary(), setup.cameras),
                now_ns=now_ns,
                first_count=random.randrange(COUNT_MODULUS),
                life=1 + now_ns // NS_PER_S,
                delay_ns=setup.radio_profile.longest_delay_ns,
            )
            for segment in Segment
        }
        self._timers = {segment: Timer(agenda, partial(self._work, segment)) for segment in Segment}
        self._sources = {
            segment: GatewaySource(end, f"{segment.value}_gateway")
            for segment, end in self.ends.items()
        }
        self._robot = RobotSource(self.ends[Segment.GROUND], first_number=0)
        self._robot_desk = robot
        self._joystick = JoystickSource(self.ends[Segment.SPACE], first_number=0)
        self._teller = None
        if isinstance(handle, OperatedHandle):
            self._teller = JoystickStatusTeller(handle)
            self._teller.handle_watched(watched=True)
        agenda.at(now_ns + SAMPLE_NS, self._sample)

    def subscribe(self, segment: Segment, take: TakeNews) -> None:
        """Call `take` with all news of a segment from now on."""
        self._takers[segment].append(take)

    def handle_request(self, segment: Segment, request: TmtcRequest, now_ns: int) -> None:
        """What a process of a segment asks for; ConfigError as `TmtcEnd.handle_request`."""
        self.ends[segment].handle_request(request, now_ns)
        self._agenda.at(now_ns, partial(self._work, segment))

    def handle_packet(self, segment: Segment, data: bytes, now_ns: int) -> bool:
        """A datagram that came by radio; False if it is not one of PUS."""
        taken = self.ends[segment].handle_packet(data, now_ns)
        if taken:
            self._work(segment, now_ns)
        return taken

    def _sample(self, now_ns: int) -> None:
        self._agenda.at(now_ns + SAMPLE_NS, self._sample)
        for segment, source in self._sources.items():
            source.handle_values(link_values(self._gateways[segment].report(now_ns)), now_ns)
        self._robot.handle_state(self._state_at(now_ns), now_ns)
        if self._robot_desk is not None:
            self._robot.handle_status(self._robot_desk.status(now_ns), now_ns)
        self._sample_joystick(now_ns)
        for segment in Segment:
            self._work(segment, now_ns)

    def _sample_joystick(self, now_ns: int) -> None:
        handle = self._handle
        if self._teller is not None:
            octets = self._teller.poll_status(now_ns)
            status = None if octets is None else unpack_status(octets)
            if status is not None:
                self._joystick.handle_status(status, now_ns)
        elif handle is not None:
            status = JoystickStatus(
                state=handle.state,
                reason="",
                dead_man=handle.dead_man,
                force_limit_n=handle.force_limit_n,
                device="simulated",
                half_width_m=0.0,
                half_height_m=0.0,
                temperature_c=handle.temperature_c if isinstance(handle, Joystick) else None,
                x_m=handle.x_m,
                y_m=handle.y_m,
            )
            self._joystick.handle_status(status, now_ns)

    def _work(self, segment: Segment, now_ns: int) -> None:
        end, send = self.ends[segment], self._send[segment]
        while (packet := end.poll_transmit(now_ns)) is not None:
            if not self._silent:
                send(packet, now_ns)
        while (news := end.next_event()) is not None:
            if isinstance(news, FunctionAsked) and self._carry_out(news, segment, now_ns):
                self._agenda.at(now_ns, partial(self._work, segment))
            for take in self._takers[segment]:
                take(news, now_ns)
        self._timers[segment].set(end.poll_timeout(now_ns), now_ns)

    def _carry_out(self, asked: FunctionAsked, segment: Segment, now_ns: int) -> bool:
        """Whether joystick or robot has carried out a function, or refused it."""
        if segment is Segment.SPACE:
            request = self._joystick.handle_asked(asked, now_ns)
            if request is None or self._teller is None:
                return False
            self._teller.handle_telecommand(request)
            self._sample_joystick(now_ns)
            return True
        command = self._robot.handle_asked(asked)
        if command is None or self._robot_desk is None:
            return False
        self._robot_desk.handle_command(command, now_ns, now_ns)
        self._robot.handle_status(self._robot_desk.status(now_ns), now_ns)
        return True
