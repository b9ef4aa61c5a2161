"""Which version of the communication software runs, and what a failed one is replaced by. A core.

A new version is on probation: application data must pass both ways within a minute of contact, or
it is marked defective. A version that has worked before is only set aside when it fails, because
the fault may be the peer's. The last one that worked comes next, and at the end the elementary
version, which stays until a person orders another one. So two ends whose versions cannot talk walk
down to a pair that can.

A program tells its state in one small JSON file, which it replaces about twice a second:
`{"contact": true, "passed": false, "stuck": false}`, as of `VersionStatus`. Any program can write
it: the path stands in the environment variable `KONTUR_AV_STATUS`.

A directory has the versions' folders, and one file with their states. That file is the pointer, and
it is replaced at once. A version's folder has its name only when it is whole. So power may fail at
any instant.
"""

import re
from collections import deque
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from enum import Enum

import msgspec

from kontur_av.clock import NS_PER_S
from kontur_av.errors import ConfigError
from telepresence.link.link_metrics import SupervisionMetrics
from telepresence.link.protection.identity import MachineIdentity
from telepresence.link.supervision.message import LinkState
from telepresence.malformed import MALFORMED
from telepresence.upkeep.file_store import (
    UNFINISHED,
    FileStore,
    StoredFile,
    read_listed,
    replace_file,
)
from telepresence.upkeep.manifest import MANIFEST, check_version, signer

#: The name of the version that is never deleted.
ELEMENTARY = "elementary"


class VersionState(Enum):
    """What is known of a version. The elementary version has no state."""

    NEW = "new"
    EXECUTABLE = "executable"
    DEFECTIVE = "defective"


@dataclass(frozen=True, slots=True, kw_only=True)
class StackRecord:
    """What outlives a power cut. It is stored as a whole.

    current: the version that runs. versions: without the elementary one; the one through which
    application data passed last comes first. tried: set aside since data passed last.
    starts: of the current version since data passed last.
    """

    current: str = ELEMENTARY
    versions: tuple[tuple[str, VersionState], ...] = ()
    tried: tuple[str, ...] = ()
    starts: int = 0

    def __post_init__(self) -> None:
        names = [ELEMENTARY, *dict(self.versions)]
        if len(names) != len(self.versions) + 1 or self.current not in names or self.starts < 0:
            raise ValueError("a record of versions that contradicts itself")

    def state(self, name: str) -> VersionState | None:
        """The state of a version; None for the elementary one, and for one that is not there."""
        return dict(self.versions).get(name)

    def with_state(self, name: str, state: VersionState) -> "StackRecord":
        """The record with another state of a version, in the same place."""
        versions = tuple((each, state if each == name else old) for each, old in self.versions)
        return replace(self, versions=versions)

    def added(self, name: str) -> "StackRecord":
        """The record with a new version. Raises ConfigError if there is one of that name."""
        if name == ELEMENTARY or self.state(name) is not None:
            raise ConfigError(f"version {name} is there already: give the new one another name")
        return replace(self, versions=(*self.versions, (name, VersionState.NEW)))

    def removed(self, name: str) -> "StackRecord":
        """The record without a version. Raises ConfigError if it must stay."""
        self._check(name)
        if name in (ELEMENTARY, self.current):
            raise ConfigError(f"version {name} stays: the elementary and the current one must")
        return replace(
            self,
            versions=tuple(each for each in self.versions if each[0] != name),
            tried=tuple(each for each in self.tried if each != name),
        )

    def ordered(self, name: str) -> "StackRecord":
        """The record after a person's order to start a version. A defective one is new again."""
        self._check(name)
        record = replace(self, current=name, tried=(), starts=0)
        if self.state(name) is VersionState.DEFECTIVE:
            return record.with_state(name, VersionState.NEW)
        return record

    def worked(self) -> "StackRecord":
        """The record after application data has passed both ways, or a person has confirmed it."""
        record = replace(self, tried=(), starts=0)
        if self.current == ELEMENTARY:
            return record
        others = [each for each in self.versions if each[0] != self.current]
        return replace(record, versions=((self.current, VersionState.EXECUTABLE), *others))

    def failed(self, *, defective: bool) -> "StackRecord":
        """The record with the next version as the current one."""
        name = self.current
        record = self.with_state(name, VersionState.DEFECTIVE) if defective else self
        tried = (*self.tried, name)
        left = (
            each
            for each, state in record.versions
            if state is VersionState.EXECUTABLE and each not in tried
        )
        return replace(record, current=next(left, ELEMENTARY), tried=tried, starts=0)

    def _check(self, name: str) -> None:
        if name != ELEMENTARY and self.state(name) is None:
            known = ", ".join([ELEMENTARY, *dict(self.versions)])
            raise ConfigError(f"there is no version {name}: there are {known}")


@dataclass(frozen=True, slots=True, kw_only=True)
class VersionStatus:
    """What a running version tells.

    contact: frames of the peer arrive. passed: in this contact application data has passed both
    ways. stuck: there is contact, but the two ends do not agree, or data does not pass. busy: an
    experiment runs, so no update may stop the program.
    """

    contact: bool
    passed: bool
    stuck: bool
    busy: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class VersionLimits:
    """The waits, in nanoseconds, and the numbers after which a version has failed.

    probation_ns: contact without application data for a new version, stuck for an older one.
    deaf_ns: without any contact; one that cannot hear has no other sign of it.
    silence_ns: without a word of the program, which is then ended and counts as crashed.
    pause_ns: before a crashed program is started again.
    crashes: in a row, without application data. starts: likewise, over power cuts.
    """

    probation_ns: int = 60 * NS_PER_S
    deaf_ns: int = 24 * 3600 * NS_PER_S
    silence_ns: int = 30 * NS_PER_S
    pause_ns: int = NS_PER_S
    crashes: int = 3
    starts: int = 8

    def __post_init__(self) -> None:
        for name in self.__slots__:
            if getattr(self, name) <= 0:
                raise ConfigError(
                    f"{name} of versions is {getattr(self, name)}: it must be above 0"
                )


@dataclass(frozen=True, slots=True)
class StoreRecord:
    """Store the record, and wait until it is safe, before the next event is done."""

    record: StackRecord


@dataclass(frozen=True, slots=True)
class StopVersion:
    """End the running program, if it still runs."""


@dataclass(frozen=True, slots=True)
class StartVersion:
    """Check the files of a version and start it, or call `handle_broken`."""

    name: str


VersionEvent = StoreRecord | StopVersion | StartVersion


class VersionSwitch:
    """Decides which version runs. Do each `next_event` in order, until there is none.

    Made at power on. Call `handle_status` for each word of the program, also if it repeats itself,
    `handle_exit` when it has ended by itself, and `handle_time` at `poll_timeout`.

    record: what was stored last. `reason` says why the current version runs.
    """

    def __init__(
        self, record: StackRecord, now_ns: int, limits: VersionLimits | None = None
    ) -> None:
        self.record = record
        self.reason = "power on"
        self._limits = VersionLimits() if limits is None else limits
        self._events: deque[VersionEvent] = deque()
        self._now_ns = now_ns
        self._status: VersionStatus | None = None
        self._crashes = 0
        self._paused = False
        self._pause_ns = 0
        self._begin_version()

    def next_event(self) -> VersionEvent | None:
        """The next thing to do; None if there is nothing."""
        return self._events.popleft() if self._events else None

    def poll_timeout(self) -> int:
        """When to call `handle_time`, at the latest."""
        limits = self._limits
        if self._paused:
            return self._now_ns + limits.pause_ns - self._pause_ns
        left_ns = limits.silence_ns - self._silence_ns
        if self.record.current != ELEMENTARY:
            left_ns = min(left_ns, limits.deaf_ns - self._deaf_ns)
            if self._judged():
                left_ns = min(left_ns, limits.probation_ns - self._judged_ns)
        return self._now_ns + left_ns

    def handle_status(self, status: VersionStatus, now_ns: int) -> None:
        """The running program tells how it is."""
        before = self.record.current
        self.handle_time(now_ns)
        if self._paused or self.record.current != before:
            # The program that said so has ended.
            return
        self._status = status
        self._silence_ns = 0
        if status.contact:
            self._deaf_ns = 0
        if status.passed:
            self._judged_ns = self._crashes = 0
            self._store(self.record.worked())
        elif status.contact and not self._judged():
            self._judged_ns = 0

    def handle_exit(self, now_ns: int) -> None:
        """The program has ended, and nobody had ordered it to."""
        self._pass_time(now_ns)
        if not self._paused:
            self._crashed("ended by itself")

    def handle_broken(self, now_ns: int) -> None:
        """The files of the version that was to start are not those of its manifest."""
        self._pass_time(now_ns)
        if self.record.current == ELEMENTARY:
            # It starts nevertheless: nothing comes after it.
            return
        self._fail("its files are damaged", defective=True)

    def handle_order(self, name: str, now_ns: int) -> None:
        """A person orders a version. Raises ConfigError if there is none of that name."""
        self._pass_time(now_ns)
        self._switch(self.record.ordered(name), "ordered")

    def handle_record(self, record: StackRecord, now_ns: int) -> None:
        """A person has added, removed or confirmed a version; the current one is the same."""
        self._pass_time(now_ns)
        assert record.current == self.record.current
        self._store(record)

    def handle_time(self, now_ns: int) -> None:
        """Judge the version by what it has told."""
        self._pass_time(now_ns)
        limits = self._limits
        if self._paused:
            if self._pause_ns >= limits.pause_ns:
                self._begin_version()
            return
        if self._silence_ns >= limits.silence_ns:
            self._events.append(StopVersion())
            self._crashed("said nothing")
        elif self.record.current == ELEMENTARY:
            return
        elif self._judged_ns >= limits.probation_ns:
            new = self._on_probation()
            why = "no application data both ways" if new else "no agreement with the peer"
            self._fail(why, defective=new)
        elif self._deaf_ns >= limits.deaf_ns:
            # A loss of signal is no fault of the version: it stays what it is.
            self._fail("no contact", defective=False)

    def _on_probation(self) -> bool:
        return self.record.state(self.record.current) is VersionState.NEW

    def _judged(self) -> bool:
        """Whether the time that passes now speaks against the version."""
        status = self._status
        if status is None or not status.contact or status.passed:
            return False
        return status.stuck or self._on_probation()

    def _pass_time(self, now_ns: int) -> None:
        """Durations, not instants, so that equal states of this object are equal."""
        passed_ns = now_ns - self._now_ns
        self._now_ns = now_ns
        if self._paused:
            self._pause_ns = min(self._pause_ns + passed_ns, self._limits.pause_ns)
            return
        self._silence_ns += passed_ns
        if self.record.current == ELEMENTARY:
            return
        if self._judged():
            self._judged_ns += passed_ns
        if self._status is None or not self._status.contact:
            self._deaf_ns += passed_ns

    def _crashed(self, why: str) -> None:
        if self.record.current != ELEMENTARY:
            self._crashes += 1
            if self._crashes >= self._limits.crashes:
                self._fail(f"{why}, {self._crashes} times", defective=self._on_probation())
                return
        self._status = None
        self._paused, self._pause_ns = True, 0

    def _fail(self, why: str, *, defective: bool) -> None:
        name = self.record.current
        self._switch(self.record.failed(defective=defective), f"{name}: {why}")

    def _switch(self, record: StackRecord, why: str) -> None:
        self.reason = why
        self._crashes = 0
        # What was to start is not started any more.
        self._events = deque(each for each in self._events if isinstance(each, StoreRecord))
        self._events.append(StopVersion())
        self._store(record)
        self._begin_version()

    def _begin_version(self) -> None:
        self._paused, self._pause_ns = False, 0
        self._status = None
        self._judged_ns = self._deaf_ns = self._silence_ns = 0
        record = self.record
        if record.current != ELEMENTARY:
            if record.starts >= self._limits.starts:
                self._fail(f"started {record.starts} times", defective=False)
                return
            self._store(replace(record, starts=record.starts + 1))
        self._events.append(StartVersion(record.current))

    def _store(self, record: StackRecord) -> None:
        if record != self.record:
            self.record = record
            self._events.append(StoreRecord(record))


VARIABLE = "KONTUR_AV_STATUS"
_APPROVE, _CONNECTED, _REFUSED = (
    state.name.lower() for state in (LinkState.APPROVE, LinkState.CONNECTED, LinkState.REFUSED)
)


def status_of(metrics: SupervisionMetrics) -> VersionStatus:
    """Return what a gateway tells. Ends that agree on flows and frames pass their data."""
    # A peer that is refused has been heard, though its frames may not count as a signal.
    contact = metrics.signal or metrics.state == _REFUSED
    return VersionStatus(
        contact=contact,
        passed=metrics.state == _CONNECTED,
        stuck=contact and metrics.state not in (_APPROVE, _CONNECTED),
    )


def pack_status(status: VersionStatus) -> bytes:
    return msgspec.json.encode(status) + b"\n"


def parse_status(octets: bytes) -> VersionStatus | None:
    """Return what a program has told; None for any other text."""
    try:
        return msgspec.json.decode(octets, type=VersionStatus)
    except MALFORMED:
        return None


#: The file with the record of the stack.
STACK = "stack.json"
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_+-]*(\.[A-Za-z0-9_+-]+)*")


class VersionDirectory:
    """The versions of one end. trusted: who may sign them."""

    def __init__(self, store: FileStore, trusted: Collection[MachineIdentity]) -> None:
        self._store, self._trusted = store, trusted

    def read(self) -> StackRecord:
        """Return the record; without a readable one, all whole versions, with none on trial."""
        try:
            return msgspec.json.decode(self._store.read(STACK), type=StackRecord)
        except (OSError, *MALFORMED):
            paths = self._store.files("")
            found = sorted({path.split("/")[0] for path in paths if path.count("/") == 1})
            versions = tuple(
                (name, VersionState.NEW)
                for name in found
                if name != ELEMENTARY and _is_name(name) and f"{name}/{MANIFEST}" in paths
            )
            return StackRecord(versions=versions)

    def store(self, record: StackRecord) -> None:
        replace_file(self._store, STACK, msgspec.json.encode(record) + b"\n")

    def check(self, name: str) -> None:
        """Raise ValueError, with the reason, unless a version is whole and signed."""
        try:
            files = read_listed(self._store, name, MANIFEST, lambda text: signer(text)[0].files)
        except OSError as error:
            raise ValueError(f"it cannot be read: {error.strerror or error}") from None
        check_version(files, name, self._trusted)

    def add(self, name: str, files: Mapping[str, StoredFile]) -> None:
        """Keep the files of a version, with its manifest. Raises ConfigError if they are not its.

        It is no version of the stack before its record has it (`StackRecord.added`).
        """
        if not _is_name(name):
            raise ConfigError(f"version {name!r}: use letters, digits and . _ + - in its name")
        try:
            check_version(files, name, self._trusted)
        except ValueError as error:
            raise ConfigError(f"version {name} is refused: {error}") from None
        if STACK not in self._store.files(""):
            # Without a record the new folder would be taken for a version of an older one.
            self.store(self.read())
        unfinished = name + UNFINISHED
        self.forget(unfinished)
        # A folder of this name is in no record.
        self.forget(name)
        for path, file in files.items():
            self._store.write(f"{unfinished}/{path}", file.octets, executable=file.executable)
        self._store.rename(unfinished, name)

    def holds(self, name: str, files: Mapping[str, StoredFile], record: StackRecord) -> bool:
        """Whether a version is here already, as one that came twice.

        It may have ended the link the first time, before its sender knew.
        """
        if record.state(name) is None or MANIFEST not in files:
            return False
        try:
            return self._store.read(f"{name}/{MANIFEST}") == files[MANIFEST].octets
        except OSError:
            return False

    def has_elementary(self) -> bool:
        return f"{ELEMENTARY}/{MANIFEST}" in self._store.files("")

    def forget(self, name: str) -> None:
        """Remove the files of a version that no record has any more."""
        for path in self._store.files(name):
            self._store.remove(f"{name}/{path}")

    def tidy(self) -> None:
        """Remove what a power cut left behind."""
        for path in self._store.files(""):
            if UNFINISHED in path.split("/")[0]:
                self._store.remove(path)


def _is_name(name: str) -> bool:
    return _NAME.fullmatch(name) is not None and UNFINISHED not in name and name != STACK
