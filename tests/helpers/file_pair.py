"""Two ends of the file transfer with directories in memory, and a bad link between them."""

from lossy_pair import LossyPair

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


class FilePair(LossyPair):
    """Ground and space with PDUs between them."""

    def __init__(
        self,
        seed: int = 0,
        *,
        loss: float = 0.0,
        doubled: float = 0.0,
        overtaken: float = 0.0,
        delay_ns: int = LossyPair.delay_ns,
        **options: int,
    ) -> None:
        super().__init__(seed, loss=loss, doubled=doubled, overtaken=overtaken)
        self.delay_ns = delay_ns
        self.ground = FileEnd(GROUND, SPACE, **options)
        self.space = FileEnd(SPACE, GROUND, **options)
        self.sent: list[bytes] = []

    def tell(self, end: FileEnd) -> FileEntity:
        return end.entity

    def take(self, end: FileEnd, pdu: bytes) -> None:
        end.entity.handle_pdu(pdu, self.now_ns)

    def note(self, end: FileEnd, pdu: bytes) -> None:
        self.sent.append(pdu)
