"""The console's process: PUS of space. `TmtcDesk` decides; this module has the sockets."""

from pipelines.mission.tmtc_desk import TmtcDesk
from pipelines.session.datagrams import receive
from pipelines.session.process import PATIENCE_NS, Context
from pipelines.session.topic_ends import NumberedTopic
from pipelines.session.topology import TELECOMMAND, TELEMETRY, WALL_TOPIC, Segment
from telepresence.haptics.mediated.wall import WALL_OCTETS, is_wall


def run_console(context: Context) -> None:
    """Carry packets between the link and the applications in space, and walls to the joystick."""
    clock, topology = context.clock, context.topology
    udp = context.listen_own(topology.exit_port(TELEMETRY))
    to_gateway = context.own_sender(topology.entry_port(TELECOMMAND))
    with context.open_bus() as bus:
        walls = None
        if context.setup.hand != "direct":
            walls = NumberedTopic(bus, WALL_TOPIC, max_octets=WALL_OCTETS)
        desk = TmtcDesk(context, bus, Segment.SPACE, to_gateway)
        waiter = bus.waiter([], [udp.fileno(), desk.socket.fileno()])
        while not context.stopping:
            now_ns = clock.now_ns()
            context.tick(now_ns)
            wall = None
            while (datagram := receive(udp)) is not None:
                if not desk.handle_packet(datagram, now_ns) and is_wall(datagram):
                    wall = datagram
            if wall is not None and walls is not None:
                walls.publish_octets(wall, now_ns)
            desk.work(now_ns)
            waiter.wait(desk.wait_ns(now_ns, PATIENCE_NS))
        del waiter
        desk.close()
