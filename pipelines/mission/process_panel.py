"""The processes of the mission control panel in space, of the built-in LED panel, and of a trainer.

`Trainer` decides what an exercise does.
"""

import select
import socket
from contextlib import suppress
from dataclasses import asdict

from kontur_av.clock import NS_PER_MS
from pipelines.hand.hand_topics import JOYSTICK_STATE_TOPIC
from pipelines.link.link_metrics import CONNECTED, link_state_topic
from pipelines.mission.tmtc_messages import FunctionAsked
from pipelines.mission.tmtc_socket import TmtcClient
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
from pipelines.session.topology.topics import PANEL
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


def run_panel(context: Context) -> None:
    """Show the cosmonaut what to do, and tell the ground."""
    clock, panel = context.clock, MissionPanel()
    with context.open_bus() as bus:
        client = TmtcClient(bus, context.session, Segment.SPACE, PANEL, first_number=clock.now_ns())
        writer = TopicWriter(bus, MISSION_PANEL_TOPIC)
        states = TopicReader(bus, JOYSTICK_STATE_TOPIC, depth=_STATES)
        links = TopicReader(bus, link_state_topic(Segment.SPACE))
        pressed, ticks = None, 0
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
            if ticks % _PUBLISH_EVERY == 0:
                client.publish({"mode": view.mode.value, "run": view.run})
            ticks += 1
            context.tick(now_ns)
            clock.sleep_until_ns(now_ns + _TICK_NS)


def run_trainer(context: Context) -> None:
    """Take requests, and publish what lasts."""
    now_ns = context.clock.now_ns
    trainer = Trainer(context.probe, TrainerReach.of(context.topology))
    context.on_flush(trainer.publish)
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
        while not context.stopping:
            context.tick(now_ns())
            server.serve(TIMEOUT_NS)
            if (exercises := trainer.poll_exercises(now_ns())) is not None:
                writer.publish(exercises, now_ns())
