"""Runs the versions of a directory: `VersionSwitch` decides, and this module does it."""

import time
from collections.abc import Callable, Collection, Mapping, Sequence
from functools import partial
from pathlib import Path

from kontur_av.clock import NS_PER_MS, NS_PER_S, MonotonicClock
from kontur_av.errors import ConfigError
from pipelines.upkeep.requests import (
    DiskStore,
    InboxFolder,
    Program,
    answer_order,
    give_order,
    keeping,
    kept,
)
from telepresence.link.protection.identity import MachineIdentity
from telepresence.upkeep.file_store import StoredFile, read_folder
from telepresence.upkeep.version_stack import (
    ELEMENTARY,
    StackRecord,
    StartVersion,
    StopVersion,
    StoreRecord,
    VersionDirectory,
    VersionLimits,
    VersionSwitch,
    parse_status,
)

_POLL_NS = 200 * NS_PER_MS
_STATUS = ".status"
#: By the words of an order: the record after it.
_RECORDS: dict[str, Callable[[StackRecord, str], StackRecord]] = {
    "add": StackRecord.added,
    "remove": StackRecord.removed,
    "start": StackRecord.ordered,
}
#: Orders that an inbox takes.
_INBOX_WORDS = ("confirm", "remove", "start")


class VersionKeeper:
    """The versions of one end on this machine. say: takes lines for people."""

    def __init__(
        self, path: Path, trusted: Collection[MachineIdentity], say: Callable[[str], None]
    ) -> None:
        self.path, self._say = path, say
        self._now_ns = MonotonicClock().now_ns
        self.store = DiskStore(path)
        self.versions = VersionDirectory(self.store, trusted)
        self._busy = False

    def read(self) -> StackRecord:
        return self.versions.read()

    @property
    def runs(self) -> bool:
        """Whether a keeper runs a version now."""
        with kept(self.path) as free:
            return not free

    def add(self, name: str, folder: Path) -> None:
        """Take over a signed version. The elementary one comes first, and stays for ever."""
        files = read_folder(DiskStore(folder), "")
        if name == ELEMENTARY:
            if self.versions.has_elementary():
                raise ConfigError("the elementary version is never replaced")
            self.versions.add(name, files)
            return
        self.read().added(name)
        self.versions.add(name, files)
        self.order("add", name)

    def order(self, word: str, name: str) -> None:
        """Change the record, or let the keeper that runs do it."""
        with kept(self.path) as free:
            if free:
                record = self.read()
                if word == "confirm":
                    self.versions.store(_confirmed(record, name))
                else:
                    self.versions.store(_RECORDS[word](record, name))
            else:
                give_order(self.path, f"{word} {name}")
        if word == "remove":
            self.versions.forget(name)

    def run(
        self,
        arguments: Sequence[str],
        stopped: Callable[[], bool],
        limits: VersionLimits,
        inbox: Path | None = None,
    ) -> None:
        """Run versions until `stopped`. Raises ConfigError if that cannot be.

        inbox: a folder where updates and orders come as files.
        """
        with keeping(self.path):
            self.versions.tidy()
            try:
                self.versions.check(ELEMENTARY)
            except ValueError as error:
                raise ConfigError(
                    f"the elementary version is missing: {error}; add it with "
                    f"`kontur-av versions add {self.path} FOLDER --name {ELEMENTARY}`"
                ) from None
            now_ns = self._now_ns
            program = Program(self.path / _STATUS, arguments)
            switch = VersionSwitch(self.read(), now_ns(), limits)
            take, obey = partial(self._take, switch), partial(self._obey, switch)
            box = None
            if inbox is not None:
                box = InboxFolder(inbox, _INBOX_WORDS, add=take, order=obey)
            try:
                while not stopped():
                    self._do(switch, program)
                    answer_order(self.path, partial(self._act, switch))
                    if box is not None:
                        box.work(busy=self._busy, now_ns=now_ns())
                    self._do(switch, program)
                    if box is not None:
                        box.publish(switch.record.current, switch.reason, _states(switch.record))
                    left_ns = switch.poll_timeout() - now_ns()
                    time.sleep(max(0, min(left_ns, _POLL_NS)) / NS_PER_S)
                    if program.exit_code() is not None:
                        switch.handle_exit(now_ns())
                        continue
                    told = program.news()
                    status = None if told is None else parse_status(told)
                    if status is None:
                        switch.handle_time(now_ns())
                    else:
                        self._busy = status.busy
                        switch.handle_status(status, now_ns())
            finally:
                program.stop()

    def _do(self, switch: VersionSwitch, program: Program) -> None:
        while (event := switch.next_event()) is not None:
            if isinstance(event, StoreRecord):
                self.versions.store(event.record)
            elif isinstance(event, StopVersion):
                program.stop()
            elif isinstance(event, StartVersion):
                self._say(f"version {event.name} starts ({switch.reason})")
                self._busy = False
                self._start(event.name, switch, program)

    def _start(self, name: str, switch: VersionSwitch, program: Program) -> None:
        try:
            self.versions.check(name)
        except ValueError as error:
            self._say(f"version {name} is damaged: {error}")
            if name != ELEMENTARY:
                switch.handle_broken(self._now_ns())
                return
        if not program.start(self.path / name):
            switch.handle_exit(self._now_ns())

    def _take(self, switch: VersionSwitch, name: str, files: Mapping[str, StoredFile]) -> str:
        """Add a version that came into the inbox, and start it."""
        if self.versions.holds(name, files, switch.record):
            return "it is there already"
        # Refused before anything is written, if there is another one of this name.
        switch.record.added(name)
        self.versions.add(name, files)
        self._act(switch, f"add {name}")
        self._act(switch, f"start {name}")
        return "added and started"

    def _obey(self, switch: VersionSwitch, order: str) -> str:
        self._act(switch, order)
        word, _, name = order.partition(" ")
        if word == "remove":
            self.versions.store(switch.record)
            self.versions.forget(name)
        return "done"

    def _act(self, switch: VersionSwitch, order: str) -> None:
        now_ns = self._now_ns()
        word, _, name = order.partition(" ")
        if word == "start":
            switch.handle_order(name, now_ns)
        elif word == "confirm":
            switch.handle_record(_confirmed(switch.record, name), now_ns)
        elif word in _RECORDS:
            switch.handle_record(_RECORDS[word](switch.record, name), now_ns)
        else:
            raise ConfigError(f"no order is called {word!r}")


def _confirmed(record: StackRecord, name: str) -> StackRecord:
    """The record after a person has said that the current version works."""
    if name != record.current:
        raise ConfigError(f"version {name} does not run: {record.current} does")
    return record.worked()


def _states(record: StackRecord) -> dict[str, str]:
    return {
        name: state.value + (", set aside" if name in record.tried else "")
        for name, state in record.versions
    }
