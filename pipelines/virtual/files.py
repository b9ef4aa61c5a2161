"""Files on virtual time: both entities, on directories in memory."""

from functools import partial

from kontur_av.clock import NS_PER_MS
from pipelines.files.desk import ENTITIES, RATES_BPS
from pipelines.session.probe import Probe
from pipelines.session.setup.segments import Segment
from pipelines.session.topology import FILES, maintenance_stream
from pipelines.virtual.agenda import Timer
from pipelines.virtual.media import Consumer
from pipelines.virtual.workers import Scene
from telepresence.files.entity import STORE, DirectoryJob, FileEntity, Transfer
from telepresence.files.pdus import GET, LIST, RENAME
from telepresence.link.flows import Level

#: As often as the process looks at the link.
_LOOK_NS = 10 * NS_PER_MS


class SimulatedFiles:
    """The file transfer of a simulation.

    directories: by segment, the files by their names. consumers: of the streams.
    """

    def __init__(self, scene: Scene) -> None:
        self._agenda, self._gateways = scene.agenda, scene.gateways
        self.directories: dict[Segment, dict[str, bytes]] = {one: {} for one in Segment}
        self.entities = {
            segment: FileEntity(
                entity=ENTITIES[segment],
                peer=ENTITIES[segment.peer],
                first_number=0,
                rate_bps=RATES_BPS[segment],
                now_ns=scene.start_ns,
                delay_ns=scene.setup.radio_profile.longest_delay_ns,
            )
            for segment in Segment
        }
        self.consumers: dict[str, Consumer] = {
            maintenance_stream(segment.peer.transmits): self.entities[segment].handle_pdu
            for segment in Segment
        }
        self._timers = {one: Timer(scene.agenda, partial(self._work, one)) for one in Segment}
        scene.agenda.at(scene.start_ns, self._look)
        for segment, entity in self.entities.items():
            probe = scene.telling.probe(FILES[segment])
            scene.telling.add(partial(self._tell, entity, probe))
        self._now_ns = scene.start_ns

    def put(self, segment: Segment, name: str, now_ns: int) -> Transfer:
        """Send a file of a segment's directory to the other end."""
        octets = self.directories[segment][name]
        return self.entities[segment].put(name, "", octets, now_ns)

    def _tell(self, entity: FileEntity, probe: Probe) -> None:
        probe.tell(entity.report(self._now_ns))

    def _look(self, now_ns: int) -> None:
        self._now_ns = now_ns
        self._agenda.at(now_ns + _LOOK_NS, self._look)
        for segment, entity in self.entities.items():
            gateway = self._gateways[segment]
            entity.handle_link(
                heard=gateway.supervisor.signal,
                waiting_octets=gateway.sender.waiting_octets(Level.MAINTENANCE),
                now_ns=now_ns,
            )
            self._work(segment, now_ns)

    def _work(self, segment: Segment, now_ns: int) -> None:
        entity, gateway = self.entities[segment], self._gateways[segment]
        while (job := entity.next_event()) is not None:
            refusal, octets = self._do(self.directories[segment], job)
            entity.handle_done(job, refusal, now_ns, octets)
        while (pdu := entity.poll_transmit(now_ns)) is not None:
            gateway.handle_datagram(maintenance_stream(segment.transmits), pdu, now_ns)
        self._timers[segment].set(entity.poll_timeout(now_ns), now_ns)

    def _do(self, directory: dict[str, bytes], job: DirectoryJob) -> tuple[str, bytes]:
        if job.kind == LIST:
            return "", "\n".join(sorted(directory)).encode()
        name = job.first
        if job.kind == STORE:
            directory[name] = job.octets
            return "", b""
        if name not in directory:
            return "no such file", b""
        if job.kind == GET:
            return "", directory[name]
        octets = directory.pop(name)
        if job.kind == RENAME:
            directory[job.second] = octets
        return "", b""
