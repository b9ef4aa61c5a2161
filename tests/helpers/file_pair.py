"""Two ends of the file transfer with directories in memory, and a bad link between them."""

from random import Random

from kontur_av.clock import NS_PER_MS, NS_PER_S
from telepresence.files.entity import STORE, DirectoryJob, FileEntity, Transfer
from telepresence.files.pdus import GET, LIST, REMOVE, RENAME

GROUND, SPACE = 1, 2


class FileEnd:
    """An entity and its directory; `restart` it as if its process had been killed."""

    def __init__(self, entity: int, peer: int, now_ns: int = 0, **options: int) -> None:
        self.files: dict[str, bytes] = {}
        self._ids, self._options = (entity, peer), {"rate_bps": 200_000, **options}
        self._first = 0
        self.restart(now_ns)

    def restart(self, now_ns: int) -> None:
        entity, peer = self._ids
        self._first += 1000
        self.entity = FileEntity(
            entity=entity, peer=peer, first_number=self._first, now_ns=now_ns, **self._options
        )

    def put(self, name: str, now_ns: int = 0, second: str = "") -> Transfer:
        return self.entity.put(name, second, self.files[name], now_ns)

    def work(self, now_ns: int) -> list[bytes]:
        """Do the jobs; return the PDUs for the other end."""
        sent = []
        while True:
            while (job := self.entity.next_event()) is not None:
                refusal, octets = self._do(job)
                self.entity.handle_done(job, refusal, now_ns, octets)
            pdu = self.entity.poll_transmit(now_ns)
            if pdu is None:
                return sent
            sent.append(pdu)

    def _do(self, job: DirectoryJob) -> tuple[str, bytes]:
        if job.kind == LIST:
            return "", "\n".join(sorted(self.files)).encode()
        if job.kind == STORE:
            self.files[job.first] = job.octets
            return "", b""
        if job.first not in self.files:
            return "no such file", b""
        if job.kind == GET:
            return "", self.files[job.first]
        octets = self.files.pop(job.first)
        assert job.kind in (RENAME, REMOVE)
        if job.kind == RENAME:
            self.files[job.second] = octets
        return "", b""


class FilePair:
    """Ground and space. By seed: PDUs are lost, doubled and overtaken; contact comes and goes."""

    def __init__(
        self,
        seed: int = 0,
        *,
        loss: float = 0.0,
        doubled: float = 0.0,
        overtaken: float = 0.0,
        delay_ns: int = 20 * NS_PER_MS,
        **options: int,
    ) -> None:
        self.now_ns = 0
        self.ground = FileEnd(GROUND, SPACE, **options)
        self.space = FileEnd(SPACE, GROUND, **options)
        self.contact = True
        self.sent: list[bytes] = []
        self._random = Random(seed)
        self._loss, self._doubled, self._overtaken = loss, doubled, overtaken
        self._delay_ns = delay_ns
        self._flying: list[tuple[int, FileEnd, bytes]] = []

    def run(self, seconds: float, step_ns: int = 10 * NS_PER_MS) -> None:
        until_ns = self.now_ns + round(seconds * NS_PER_S)
        while self.now_ns < until_ns:
            self.now_ns += step_ns
            self.step()

    def step(self) -> None:
        now_ns, random = self.now_ns, self._random
        for end in (self.ground, self.space):
            end.entity.handle_link(heard=self.contact, waiting_octets=0, now_ns=now_ns)
        if not self.contact:
            self._flying.clear()
        arrived = [one for one in self._flying if one[0] <= now_ns]
        arrived.sort(key=lambda one: one[0])
        self._flying = [one for one in self._flying if one[0] > now_ns]
        for _, end, pdu in arrived:
            end.entity.handle_pdu(pdu, now_ns)
        for end, other in ((self.ground, self.space), (self.space, self.ground)):
            for pdu in end.work(now_ns):
                self.sent.append(pdu)
                for _ in range(2 if random.random() < self._doubled else 1):
                    if random.random() < self._loss:
                        continue
                    late_ns = random.randrange(NS_PER_S) if random.random() < self._overtaken else 0
                    self._flying.append((now_ns + self._delay_ns + late_ns, other, pdu))
