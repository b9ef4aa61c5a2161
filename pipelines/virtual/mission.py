"""Tasks on virtual time: experimenter, kernel and robot below, panel and cosmonaut above."""

from collections.abc import Callable

from pipelines.hand.haptics import JoystickEnd
from pipelines.hand.robot_desk import RobotDesk
from pipelines.mission.choosing import CameraChoice
from pipelines.mission.mission import MissionGround, Seen, robot_order
from pipelines.mission.tmtc_messages import (
    K2aciArrived,
    SendK2aci,
    TmtcNews,
    k2aci_message,
    plain_fields,
)
from pipelines.session.setup.segments import Segment
from pipelines.session.task_journal import LinkMeanwhile
from pipelines.virtual.agenda import Agenda
from pipelines.virtual.tmtc import SimulatedTmtc
from telepresence.haptics.sample import STATE_HALTED
from telepresence.link.gateway import Gateway
from telepresence.link.supervision.message import LinkState
from telepresence.tasks.cosmonaut import LOOK_NS, Cosmonaut
from telepresence.tasks.definitions import Catalogue
from telepresence.tasks.kernel import (
    TICK_NS,
    ChooseCamera,
    Record,
)
from telepresence.tasks.panel import MissionPanel
from telepresence.tasks.panel_picture import LedPanel, PanelPicture
from telepresence.tasks.plan import SessionPlan
from telepresence.tmtc.k2aci import K2aciMessage

#: How old the picture of the LED panel is that the cosmonaut sees.
_SEEN_NS = 3 * LOOK_NS
_CLIENT = "mission"
_HALTED = "The joystick is halted."


class SimulatedMission:
    """Follows a plan in a simulation.

    select: selects a camera on the ground, at an instant.
    """

    def __init__(
        self,
        plan: SessionPlan,
        catalogue: Catalogue,
        cosmonaut: Cosmonaut,
        *,
        robot: RobotDesk,
        joystick: JoystickEnd,
        gateways: dict[Segment, Gateway],
        tmtc: SimulatedTmtc,
        choice: CameraChoice,
        select: Callable[[str, int], None],
        agenda: Agenda,
        now_ns: int,
    ) -> None:
        self._ground = MissionGround(catalogue, plan, now_ns=now_ns)
        self._panel = MissionPanel()
        self._cosmonaut = cosmonaut
        self._robot, self._joystick = robot, joystick.side
        self._gateways, self._tmtc = gateways, tmtc
        self._choice, self._select = choice, select
        self._agenda = agenda
        self._leds = LedPanel()
        self._seen: list[PanelPicture] = []
        self._recording = False
        self._numbers = dict.fromkeys(Segment, 0)
        self._pressed = 0
        self.journal = self._ground.journal
        self._joystick.handle.dead_man = False
        tmtc.subscribe(Segment.GROUND, self._hear_below)
        tmtc.subscribe(Segment.SPACE, self._hear_above)
        agenda.at(now_ns + TICK_NS, self._tick)
        agenda.at(now_ns + LOOK_NS, self._look)

    def _connected(self, segment: Segment) -> bool:
        return self._gateways[segment].supervisor.state is LinkState.CONNECTED

    def _look(self, now_ns: int) -> None:
        """What happens in space."""
        self._agenda.at(now_ns + LOOK_NS, self._look)
        panel, handle, cosmonaut = self._panel, self._joystick.handle, self._cosmonaut
        panel.handle_contact(self._connected(Segment.SPACE), now_ns)
        while self._pressed < cosmonaut.pressed:
            self._pressed += 1
            panel.handle_button(now_ns)
        halted = _HALTED if handle.state >= STATE_HALTED else ""
        panel.handle_handle(
            handle.x_m, handle.y_m, dead_man=handle.dead_man, halted=halted, now_ns=now_ns
        )
        self._seen.append(self._leds.picture(now_ns))
        picture = self._seen.pop(0) if len(self._seen) > _SEEN_NS // LOOK_NS else self._seen[0]
        robot = self._robot.control.robot
        cosmonaut.look(panel.view, picture, (robot.x_m, robot.y_m), (handle.x_m, handle.y_m))
        handle.dead_man = cosmonaut.dead_man
        self._send(Segment.SPACE, panel.poll_message, now_ns)

    def _tick(self, now_ns: int) -> None:
        """What happens on the ground."""
        self._agenda.at(now_ns + TICK_NS, self._tick)
        seen = Seen(
            robot=self._robot.status(now_ns),
            camera=self._choice.selected,
            recording=self._recording,
            signal=self._connected(Segment.GROUND),
            link=self._meanwhile(now_ns),
        )
        self._ground.handle_tick(seen, now_ns)
        self._settle(now_ns)
        sender = self._ground.leds
        while (octets := sender.poll_transmit(now_ns)) is not None:
            self._leds.handle_datagram(octets, now_ns)
            while (answer := self._leds.poll_transmit(now_ns)) is not None:
                sender.handle_datagram(answer, now_ns)

    def _meanwhile(self, now_ns: int) -> LinkMeanwhile:
        reports = [gateway.report(now_ns) for gateway in self._gateways.values()]
        return LinkMeanwhile(
            frames=sum(report.receive.frames_received for report in reports),
            frames_lost=sum(report.receive.frames_lost for report in reports),
            delay_ns=max(report.radio.delay_ns for report in reports),
        )

    def _settle(self, now_ns: int) -> None:
        while (order := self._ground.poll_order()) is not None:
            if isinstance(order, ChooseCamera):
                self._select(order.name, now_ns)
            elif isinstance(order, Record):
                self._recording = order.on
            elif (told := robot_order(order, 0)) is not None:
                self._robot.handle_order(told, now_ns, now_ns)
        self._send(Segment.GROUND, self._ground.poll_message, now_ns)

    def _send(self, segment: Segment, poll: Callable[[], K2aciMessage | None], now_ns: int) -> None:
        while (message := poll()) is not None:
            self._numbers[segment] += 1
            request = SendK2aci(
                _CLIENT, self._numbers[segment], type(message).__name__, plain_fields(message)
            )
            self._tmtc.handle_request(segment, request, now_ns)

    def _hear_above(self, news: TmtcNews, now_ns: int) -> None:
        if isinstance(news, K2aciArrived):
            self._panel.handle_message(k2aci_message(news.kind, news.fields), now_ns)

    def _hear_below(self, news: TmtcNews, now_ns: int) -> None:
        if isinstance(news, K2aciArrived):
            self._ground.handle_message(k2aci_message(news.kind, news.fields), now_ns)
            # What follows from it is done at its own instant, not within the gateway's event.
            self._agenda.at(now_ns, self._settle)
