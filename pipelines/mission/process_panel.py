"""The processes of the mission control panel in space, of the built-in LED panel, and of a trainer.

`Trainer` decides what an exercise does.
"""

import select
import socket
from contextlib import suppress
from dataclasses import asdict

from kontur_av.clock import NS_PER_MS
from kontur_av.errors import ConfigError
from kontur_av.topics.bus import TopicBus
from pipelines.hand.hand_topics import JOYSTICK_STATE_TOPIC
from pipelines.link.link_metrics import CONNECTED, link_state_topic
from pipelines.mission.tmtc_messages import (
    TMTC_TOPICS,
    CommandUpdate,
    FunctionAsked,
    RaiseEvent,
    SendCommand,
)
from pipelines.mission.tmtc_socket import TmtcClient, send_to_tmtc
from pipelines.session.datagrams import Address
from pipelines.session.mission_messages import (
    MISSION_LEDS_TOPIC,
    MISSION_PANEL_TOPIC,
    LedsShown,
    PanelShown,
)
from pipelines.session.process import TIMEOUT_NS, Context
from pipelines.session.requests import RequestServer
from pipelines.session.setup.segments import Segment
from pipelines.session.topic_ends import TopicReader, TopicWriter
from pipelines.session.topology.streams import leds_port
from pipelines.session.topology.topics import PANEL, TRAINER
from pipelines.session.training import (
    TRAINER_SOCKET,
    TRAINER_TOPIC,
    Trainer,
    TrainerReach,
    TrainerRequest,
)
from telepresence.haptics.device.states import JoystickState
from telepresence.tasks.panel import MissionPanel
from telepresence.tasks.panel_picture import STATE_OCTETS, LedPanel

_TICK_S = 0.02


def run_leds(context: Context) -> None:
    """Show what the datagrams say, and acknowledge them."""
    clock, panel = context.clock, LedPanel()
    udp = context.listen(leds_port(context.setup))
    ready = select.poll()
    ready.register(udp, select.POLLIN)
    with context.open_bus() as bus:
        writer = TopicWriter(bus, MISSION_LEDS_TOPIC)
        while not context.stopping:
            ready.poll(_TICK_S * 1000)
            now_ns = clock.now_ns()
            while (found := _receive(udp)) is not None:
                octets, sender = found
                panel.handle_datagram(octets, now_ns)
                while (answer := panel.poll_transmit(now_ns)) is not None:
                    with suppress(OSError):
                        udp.sendto(answer, sender)
            # Published repeatedly, for readers that have started since.
            writer.publish(LedsShown.of(panel.picture(now_ns)), now_ns)
            context.tick(now_ns)


def _receive(udp: socket.socket) -> tuple[bytes, Address] | None:
    while True:
        try:
            return udp.recvfrom(STATE_OCTETS + 1)
        except BlockingIOError:
            return None
        except ConnectionError:
            continue


_TICK_NS = 50 * NS_PER_MS
#: The panel's parameters are told once in this many ticks.
_PUBLISH_EVERY = 20
_STATES = 8
_NEWS = 32


def run_panel(context: Context) -> None:
    """Show the cosmonaut what to do, and tell the ground."""
    clock, panel = context.clock, MissionPanel()
    with context.open_bus() as bus:
        client = TmtcClient(bus, context.session, Segment.SPACE, PANEL, first_number=clock.now_ns())
        writer = TopicWriter(bus, MISSION_PANEL_TOPIC)
        states = TopicReader(bus, JOYSTICK_STATE_TOPIC, depth=_STATES)
        links = TopicReader(bus, link_state_topic(Segment.SPACE))
        pressed, ticks, mode = None, 0, None
        while not context.stopping:
            now_ns = clock.now_ns()
            if (link := links.latest()) is not None:
                panel.handle_contact(link.get("state") == CONNECTED, now_ns)
            for came in client.work(now_ns):
                if isinstance(came, FunctionAsked):
                    panel.handle_button(now_ns)
                    client.answer(came, "")
                else:
                    panel.handle_message(came, now_ns)
            while (status := states.next()) is not None:
                # A joystick that was restarted counts anew.
                if pressed is not None and status.pressed > pressed:
                    panel.handle_button(now_ns)
                pressed = status.pressed
            if (status := states.newest) is not None:
                halted = status.state >= JoystickState.HALTED
                panel.handle_handle(
                    status.x_m,
                    status.y_m,
                    dead_man=status.dead_man,
                    halted=(status.reason or "The joystick is halted.") if halted else "",
                    now_ns=now_ns,
                )
            while (message := panel.poll_message()) is not None:
                client.send(message, now_ns)
            view = panel.view
            shown = PanelShown(
                **asdict(view),
                handle_m=(0.0, 0.0) if status is None else (status.x_m, status.y_m),
                dead_man=status is not None and status.dead_man,
            )
            writer.publish(shown, now_ns)
            if ticks % _PUBLISH_EVERY == 0 or view.mode is not mode:
                client.publish({"mode": view.mode.value, "run": view.run})
            if view.mode is not mode:
                # Its report comes every 10 s only.
                mode = view.mode
                send_to_tmtc(context.session, Segment.SPACE, RaiseEvent(PANEL, "mode_changed"))
            ticks += 1
            context.tick(now_ns)
            clock.sleep_until_ns(now_ns + _TICK_NS)


class _TrainerOfGround:
    """Joins the trainers of both ends by telecommands: space asks, the ground does.

    end: of this trainer. A telecommand is handed over until the end has it.
    """

    def __init__(self, context: Context, bus: TopicBus, trainer: Trainer, end: Segment) -> None:
        first = context.clock.now_ns()
        self._trainer, self._session, self._end = trainer, context.session, end
        self._client = f"{TRAINER} {first}"
        self._tmtc = TmtcClient(bus, context.session, end, TRAINER, first_number=first)
        self._news = TopicReader(bus, TMTC_TOPICS[end], depth=_NEWS)
        self._number = 0
        self._open: dict[int, SendCommand] = {}
        self._taken: set[int] = set()

    def work(self, now_ns: int) -> None:
        if self._end is Segment.GROUND:
            for asked in self._tmtc.work(now_ns):
                if isinstance(asked, FunctionAsked):
                    self._tmtc.answer(asked, self._done(asked, now_ns))
            return
        while (call := self._trainer.next_asked()) is not None:
            self._number += 1
            self._open[self._number] = SendCommand(
                self._client, self._number, TRAINER, "call", *call
            )
        while (news := self._news.next()) is not None:
            if isinstance(news, CommandUpdate) and news.client == self._client:
                self._taken.add(news.id)
                if news.done and (command := self._open.pop(news.id, None)) is not None:
                    refusal = "" if news.ok else news.reason or "no answer"
                    self._trainer.handle_answered(command.name, refusal, now_ns)
        for number, command in self._open.items():
            if number not in self._taken:
                send_to_tmtc(self._session, self._end, command)

    def _done(self, asked: FunctionAsked, now_ns: int) -> str:
        seconds = float(asked.arguments[0]) if asked.arguments else 0.0
        exercise = asked.function.replace("_", "-")
        try:
            request = TrainerRequest(exercise=exercise, seconds=seconds)
            self._trainer.handle_request(request, now_ns)
        except ConfigError as error:
            return str(error)
        return ""


def run_trainer(context: Context) -> None:
    """Take requests, and publish what lasts."""
    now_ns = context.clock.now_ns
    trainer = Trainer(context.probe, TrainerReach.of(context.topology))
    context.on_flush(trainer.publish)
    topology = context.topology
    end = Segment.SPACE if topology.alone is Segment.SPACE else Segment.GROUND
    with (
        context.open_bus() as bus,
        RequestServer(
            context,
            TRAINER_SOCKET,
            TrainerRequest,
            lambda request, _: trainer.handle_request(request, now_ns()),
        ) as server,
    ):
        writer = TopicWriter(bus, TRAINER_TOPIC)
        ground = _TrainerOfGround(context, bus, trainer, end)
        while not context.stopping:
            context.tick(now_ns())
            server.serve(TIMEOUT_NS)
            ground.work(now_ns())
            if (exercises := trainer.poll_exercises(now_ns())) is not None:
                writer.publish(exercises, now_ns())
