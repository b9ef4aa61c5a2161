"""What one process of a session reported, over all its lives. A core."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import TypeVar

from kontur_av.meters import Histogram
from pipelines.session.figures import (
    CaptureGauges,
    Counters,
    DisplayGauges,
    GatewayGauges,
    Gauges,
    SelectorGauges,
)
from pipelines.session.probe import FLUSH_NS, Message
from telepresence.link.figures import GatewayFigures

#: An input reports twice a second. It has paused if its captures lie this far apart.
_PAUSE_NS = 3 * FLUSH_NS

CountersT = TypeVar("CountersT", bound=Counters)
GaugesT = TypeVar("GaugesT", bound=Gauges)


@dataclass
class ProcessFigures:
    """What one process of the session reported, over all its lives."""

    #: `fifo` with real-time priority, `other` without the permission for it.
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
    _counters: dict[tuple[type[Counters], str], Counters] = field(default_factory=dict)
    _ended: dict[tuple[type[Counters], str], Counters] = field(default_factory=dict)
    _gauges: dict[tuple[type[Gauges], str], Gauges] = field(default_factory=dict)

    def handle_message(self, message: Message, now_ns: int) -> None:
        """Take a report of the process."""
        self.told_ns = now_ns
        if self.began_ns is None:
            self.began_ns = now_ns
        captured_ns, selected = self.captured_ns, self.selected
        self.scheduler = message.scheduler or self.scheduler
        self.last_error = message.last_error or self.last_error
        self._counters.update(message.counters)
        for key, newest in message.gauges.items():
            earlier = self._gauges.get(key)
            self._gauges[key] = newest if earlier is None else newest.over(earlier)
        if self.selected != selected:
            self.selected_ns = now_ns
        newest_ns = self.captured_ns
        if newest_ns is not None and (captured_ns is None or newest_ns - captured_ns > _PAUSE_NS):
            self.gives_since_ns = newest_ns

    def gauges(self, kind: type[GaugesT], stream: str = "") -> GaugesT | None:
        """The newest values of one kind; None if no life reported any."""
        found = self._gauges.get((kind, stream))
        assert found is None or isinstance(found, kind)
        return found

    def counted(self, kind: type[CountersT], stream: str = "") -> CountersT | None:
        """Counters of one kind, over all lives; None if no life reported any."""
        ended, counters = self._ended.get((kind, stream)), self._counters.get((kind, stream))
        found = counters if ended is None else ended if counters is None else ended.plus(counters)
        assert found is None or isinstance(found, kind)
        return found

    def total(self, kind: type[CountersT], stream: str = "") -> CountersT:
        """Counters of one kind, over all lives; all 0 if no life reported any."""
        return self.counted(kind, stream) or kind()

    def counts_by_name(self) -> dict[str, int]:
        """All counters, over all lives, by name, with the name of their stream in front."""
        found: dict[str, int] = {}
        for kind, stream in {**self._ended, **self._counters}:
            about = f"{stream}." if stream else ""
            for name, count in self.total(kind, stream).by_name().items():
                found[about + name] = count
        return dict(sorted(found.items()))

    @property
    def captured_ns(self) -> int | None:
        """When an input captured last; None if it never did, or is none."""
        gauges = self.gauges(CaptureGauges)
        return None if gauges is None else gauges.captured_ns

    @property
    def source_fault(self) -> str | None:
        """The last fault of an input's source."""
        gauges = self.gauges(CaptureGauges)
        return None if gauges is None else gauges.source_fault

    @property
    def live_source(self) -> str | None:
        """Whether an input captures its "own" source or that of a "page", in a session with any."""
        gauges = self.gauges(CaptureGauges)
        return None if gauges is None else gauges.live_source

    @property
    def selected(self) -> str | None:
        """The selected camera; of the selector."""
        gauges = self.gauges(SelectorGauges)
        return None if gauges is None else gauges.selected

    @property
    def link(self) -> GatewayFigures | None:
        """The link, as this life of a gateway reported it."""
        gauges = self.gauges(GatewayGauges)
        return None if gauges is None else gauges.link

    def silent_ns(self, now_ns: int | None = None) -> int:
        """How long an input has captured nothing by `now_ns`, or by its last report."""
        since_ns = self.began_ns if self.captured_ns is None else self.captured_ns
        if since_ns is None:
            return 0
        until_ns = self.told_ns if now_ns is None else now_ns
        return max(0, until_ns - max(since_ns, self._resumed_ns))

    def handle_end(self) -> None:
        """The process has ended. Its counts are kept, because the next life begins at 0."""
        for key, counters in self._counters.items():
            ended = self._ended.get(key)
            self._ended[key] = counters if ended is None else ended.plus(counters)
        self._counters = {}
        if self.link is not None:
            self.ended_links.append(self.link)
            del self._gauges[GatewayGauges, ""]

    def handle_resumed(self, now_ns: int) -> None:
        """The process starts again after a stop that was asked for: it has shown nothing yet."""
        self._resumed_ns = now_ns
        for key in [key for key in self._gauges if key[0] is DisplayGauges]:
            del self._gauges[key]

    def links(self) -> Iterator[GatewayFigures]:
        """The link's counters of each life."""
        yield from self.ended_links
        if self.link is not None:
            yield self.link
