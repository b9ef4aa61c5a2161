"""Two ends of a link, each with its versions, on virtual time: what runs, and what each sees."""

from dataclasses import dataclass, field
from random import Random

from telepresence.upkeep.version_stack import (
    ELEMENTARY,
    StackRecord,
    StartVersion,
    StopVersion,
    StoreRecord,
    VersionLimits,
    VersionState,
    VersionStatus,
    VersionSwitch,
)

SECOND = 1_000_000_000
#: A short wait for contact, so that histories end within an hour.
LIMITS = VersionLimits(deaf_ns=600 * SECOND, crashes=3, starts=5)
NOTHING = VersionStatus(contact=False, passed=False, stuck=False)

#: What two running versions see of each other: contact here, contact there, agreement, data.
DEAF, HEARD, HEARS, REFUSED, AGREED, WORKS = range(6)


@dataclass
class Ways:
    """Which versions can talk: `pairs` by the names at both ends."""

    pairs: dict[tuple[str, str], int] = field(default_factory=dict)
    #: Versions that see contact with an elementary peer.
    hears_elementary: set[tuple[int, str]] = field(default_factory=set)

    def works(self, first: str, second: str) -> bool:
        return first == second == ELEMENTARY or self.pairs.get((first, second)) == WORKS

    def status(self, end: int, own: str | None, peer: str | None) -> VersionStatus:
        """What the program at an end tells while the radio carries all."""
        if own is None or peer is None:
            return NOTHING
        pair = (own, peer) if end == 0 else (peer, own)
        if self.works(*pair):
            return VersionStatus(contact=True, passed=True, stuck=False)
        if own == ELEMENTARY:
            # It understands the first octet of every version.
            contact = True
        elif peer == ELEMENTARY:
            contact = (end, own) in self.hears_elementary
        else:
            level = self.pairs.get(pair, DEAF)
            contact = level >= REFUSED or level == (HEARS if end == 0 else HEARD)
        return VersionStatus(contact=contact, passed=False, stuck=contact)


class VersionEnd:
    """One end. A power cut keeps only what was stored.

    broken: versions that end at once. silent: versions that run and say nothing.
    """

    def __init__(self, record: StackRecord, random: Random, limits: VersionLimits = LIMITS):
        self.stored, self.random, self.limits = record, random, limits
        self.broken: set[str] = set()
        self.silent: set[str] = set()
        self.switch: VersionSwitch | None = None
        self.running: str | None = None
        #: The steps that are left before power fails in the middle of what the switch orders.
        self.fuse: int | None = None

    def power_on(self, now_ns: int) -> None:
        self.running = None
        self.switch = VersionSwitch(self.stored, now_ns, self.limits)
        self.work(now_ns)

    def power_off(self) -> None:
        self.switch = self.running = self.fuse = None

    def work(self, now_ns: int) -> None:
        """Do what the switch orders, one event after the other."""
        while self.switch is not None and (event := self.switch.next_event()) is not None:
            if self.fuse is not None:
                self.fuse -= 1
                if self.fuse < 0:
                    self.power_off()
                    return
            if isinstance(event, StoreRecord):
                self.stored = event.record
            elif isinstance(event, StopVersion):
                self.running = None
            elif isinstance(event, StartVersion):
                self.running = event.name
                if event.name in self.broken:
                    self.running = None
                    self.switch.handle_exit(now_ns)

    def add(self, name: str, now_ns: int) -> None:
        """An update has arrived whole, and a person orders it."""
        if self.switch is None:
            return
        if self.switch.record.state(name) is None:
            self.switch.handle_record(self.switch.record.added(name), now_ns)
        self.switch.handle_order(name, now_ns)
        self.work(now_ns)


def status_at(ways: Ways, ends: list[VersionEnd], end: int) -> VersionStatus:
    return ways.status(end, ends[end].running, ends[1 - end].running)


def executable(*names: str) -> StackRecord:
    """A record whose first version runs and has worked."""
    versions = tuple((name, VersionState.EXECUTABLE) for name in names)
    return StackRecord(current=names[0] if names else ELEMENTARY, versions=versions)
