"""What one process of a session reported, over all its lives. A core."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import TypeVar

from kontur_av.figures import counts, newest, over, plus
from kontur_av.meters import Histogram
from kontur_av.streams.staleness import State
from pipelines.media.figures import CaptureFigures, DisplayFigures, SelectorFigures
from pipelines.session.probe import FLUSH_NS, Message
from telepresence.link.figures import GatewayFigures

#: An input reports twice a second. It has paused if its captures lie this far apart.
_PAUSE_NS = 3 * FLUSH_NS

RecordT = TypeVar("RecordT")


@dataclass
class ProcessFigures:
    """What one process of the session reported, over all its lives."""

    #: `fifo` with real-time priority, else `other`.
    scheduler: str | None = None
    #: Why its newest life that failed ended.
    last_error: str | None = None
    lateness: Histogram = field(default_factory=Histogram)
    #: From a slot's deadline to the instant at which its frame had been sent; of a gateway.
    sending: Histogram = field(default_factory=Histogram)
    #: The link's counters of the lives that have ended.
    ended_links: list[GatewayFigures] = field(default_factory=list)
    #: Its first and its last report.
    began_ns: int | None = None
    told_ns: int = 0
    #: When the present camera was selected; of the selector.
    selected_ns: int = 0
    #: When the last pause in its captures ended; of an input.
    gives_since_ns: int = 0
    #: When it was started again after a stop that was asked for.
    _resumed_ns: int = 0
    #: By kind and stream: the records of this life, and of the lives before.
    _told: dict[tuple[type, str], object] = field(default_factory=dict)
    _ended: dict[tuple[type, str], object] = field(default_factory=dict)

    def handle_message(self, message: Message, now_ns: int) -> None:
        self.told_ns = now_ns
        if self.began_ns is None:
            self.began_ns = now_ns
        captured_ns, selected = self.capture.captured_ns, self.selected
        self.scheduler = message.scheduler or self.scheduler
        self.last_error = message.last_error or self.last_error
        for key, record in message.figures.items():
            earlier = self._told.get(key)
            self._told[key] = record if earlier is None else over(record, earlier)
        if self.selected != selected:
            self.selected_ns = now_ns
        newest_ns = self.capture.captured_ns
        if newest_ns is not None and (captured_ns is None or newest_ns - captured_ns > _PAUSE_NS):
            self.gives_since_ns = newest_ns

    def find(self, kind: type[RecordT], stream: str = "") -> RecordT | None:
        """The record of one kind, over all lives; None if no life told any."""
        ended, told = self._ended.get((kind, stream)), self._told.get((kind, stream))
        found = told if ended is None else ended if told is None else plus(ended, told)
        assert found is None or isinstance(found, kind)
        return found

    def total(self, kind: type[RecordT], stream: str = "") -> RecordT:
        """The record of one kind, over all lives; all 0 if no life told any."""
        return self.find(kind, stream) or kind()

    def counts_by_name(self) -> dict[str, int]:
        """What adds up, over all lives, by name, with the name of its stream in front."""
        found = {
            about + name: count
            for about, record in self._records()
            for name, count in counts(record).items()
        }
        return dict(sorted(found.items()))

    def newest_by_name(self) -> dict[str, int | float | str | bool]:
        """All other values that are known, in the same way."""
        return {
            about + name: value
            for about, record in self._records()
            for name, value in newest(record).items()
        }

    def _records(self) -> list[tuple[str, object]]:
        keys = sorted({**self._ended, **self._told}, key=lambda key: key[1])
        return [(f"{key[1]}." if key[1] else "", self.total(*key)) for key in keys]

    @property
    def capture(self) -> CaptureFigures:
        return self.total(CaptureFigures)

    @property
    def selected(self) -> str | None:
        return self.total(SelectorFigures).selected

    @property
    def link(self) -> GatewayFigures | None:
        """The link, as this life of a gateway reported it."""
        found = self._told.get((GatewayFigures, ""))
        assert found is None or isinstance(found, GatewayFigures)
        return found

    def silent_ns(self, now_ns: int | None = None) -> int:
        """How long an input has captured nothing by `now_ns`, or by its last report."""
        captured_ns = self.capture.captured_ns
        since_ns = self.began_ns if captured_ns is None else captured_ns
        if since_ns is None:
            return 0
        until_ns = self.told_ns if now_ns is None else now_ns
        return max(0, until_ns - max(since_ns, self._resumed_ns))

    def handle_end(self) -> None:
        """The process has ended. Its records are kept, because the next life begins at 0."""
        if self.link is not None:
            self.ended_links.append(self.link)
            del self._told[GatewayFigures, ""]
        for key, told in self._told.items():
            ended = self._ended.get(key)
            self._ended[key] = told if ended is None else plus(ended, told)
        self._told = {}

    def handle_resumed(self, now_ns: int) -> None:
        """The process starts again after a stop that was asked for: it has shown nothing yet."""
        self._resumed_ns = now_ns
        for records in (self._ended, self._told):
            for key, record in records.items():
                if isinstance(record, DisplayFigures):
                    records[key] = replace(record, age_ns=None, state=State.NOTHING)

    def links(self) -> Iterator[GatewayFigures]:
        """The link's counters of each life."""
        yield from self.ended_links
        if self.link is not None:
            yield self.link
