"""The process that carries files. `FileEntity` decides; this module has sockets and directory."""

import select
from dataclasses import dataclass
from pathlib import Path

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.topics.session_files import make_session_root
from pipelines.files.desk import ENTITIES, FileAnswer, FileDesk, FileRequest, desk_name
from pipelines.files.directory import FencedDirectory
from pipelines.session.asking import desk_path
from pipelines.session.datagrams import receive
from pipelines.session.process import PATIENCE_NS, Context
from pipelines.session.terminal_lines import MOST_TERMINALS, LineDesk
from pipelines.session.terminals import TerminalSockets
from pipelines.session.topology import Segment, maintenance_stream
from telepresence.files.entity import PUT, FileEntity
from telepresence.link.backlog import Backlog
from telepresence.link.frame import MAX_PACKET_OCTETS

#: How often the state of the link is looked at while something is to be sent.
_LOOK_NS = 10 * NS_PER_MS
#: Numbers of transactions count such units of Unix time, so that no later life has the same.
_NUMBER_NS = NS_PER_S // 10


@dataclass(frozen=True, kw_only=True)
class FilesPlan:
    """directory: of this end. rate_bps: the most that is sent."""

    directory: Path
    rate_bps: int


def run_files(context: Context, plan: FilesPlan, *, segment: Segment) -> None:
    """Carry PDUs between the link and the entity, and do what it asks of the directory."""
    clock, topology = context.clock, context.topology
    directory = FencedDirectory(plan.directory)
    now_ns = clock.now_ns()
    entity = FileEntity(
        entity=ENTITIES[segment],
        peer=ENTITIES[segment.peer],
        first_number=(now_ns + clock.wall_offset_ns) // _NUMBER_NS,
        rate_bps=plan.rate_bps,
        now_ns=now_ns,
        delay_ns=context.setup.radio_profile.longest_delay_ns,
    )
    desk = FileDesk(entity)

    def answer(request: FileRequest, now_ns: int) -> FileAnswer:
        refusal, octets = directory.read(request.first) if request.file == PUT else ("", b"")
        return desk.handle_request(request, octets, refusal, now_ns)

    lines = LineDesk(FileRequest, answer)
    udp = context.listen_media(topology.exit_port(maintenance_stream(segment.peer.transmits)))
    send = context.sender(topology.entry_port(maintenance_stream(segment.transmits)))
    context.on_flush(lambda: context.probe.tell(entity.report(clock.now_ns())))
    make_session_root(context.session)
    terminals = TerminalSockets(desk_path(context.session, desk_name(segment)), most=MOST_TERMINALS)
    with context.open_bus() as bus:
        link = bus.reader(topology.link(segment.transmits).backlog_topic)
        while not context.stopping:
            now_ns = clock.now_ns()
            context.tick(now_ns)
            if (told := link.latest_octets()) is not None:
                state = Backlog.unpack(told)
                entity.handle_link(
                    heard=state.peer_heard,
                    waiting_octets=state.maintenance_octets,
                    now_ns=now_ns,
                )
            while (octets := receive(udp, MAX_PACKET_OCTETS + 1)) is not None:
                entity.handle_pdu(octets, now_ns)
            while (job := entity.next_event()) is not None:
                refusal, found = directory.do(job)
                entity.handle_done(job, refusal, now_ns, found)
            while (pdu := entity.poll_transmit(now_ns)) is not None:
                send(pdu)
            while (reply := lines.next_event()) is not None:
                terminals.send(reply.terminal, reply.octets, last=reply.last)
            due_ns = entity.poll_timeout(now_ns)
            wait_ns = PATIENCE_NS if due_ns is None else max(0, due_ns - clock.now_ns())
            wait_ns = min(wait_ns, _LOOK_NS if entity.open else PATIENCE_NS)
            asking = lines.asking
            readers = [udp, *terminals.readers(asking)]
            ready = select.select(readers, [], [], wait_ns / NS_PER_S)[0]
            now_ns = clock.now_ns()
            if (terminal := terminals.accept(ready)) is not None:
                lines.handle_terminal(terminal)
            for terminal, data in terminals.read(ready, asking):
                lines.handle_octets(terminal, data, now_ns)
    terminals.close()
