"""The access units of one stream for decoders that begin in its middle. A core.

A stream has an IDR picture at its beginning and after a loss only. So the process that has its
coder publishes a key picture for each reader that joins the topic (`coded_topics.py`). It shows
what the unit of the same number shows, and comes a little later than that unit. Until it is there,
the units are kept; a decoder begins with it and those after it. Where units were missed, decoders
begin anew, since most streams refresh their picture once a minute only.
"""

from collections.abc import Sequence
from typing import NamedTuple

from kontur_av.clock import NS_PER_S, NS_PER_US
from kontur_av.media import CaptureStamp, VideoCodec
from kontur_av.rtp.nal_formats import parameter_sets_of
from kontur_av.streams.coded_unit import CodedUnit

_BEHIND_NS = NS_PER_US
#: A key picture that does not come is asked for again.
_AGAIN_NS = NS_PER_S
#: Units wait no longer for a key picture, and no more of them.
MOST_KEPT_NS = 5 * NS_PER_S
MOST_KEPT_OCTETS = 1 << 20


class StreamUnit(NamedTuple):
    """A unit for a decoder, published at `at_ns`.

    data: of the unit, with parameter sets ahead where a decoder that begins needs them.
    """

    unit: CodedUnit
    stamp: CaptureStamp
    at_ns: int
    data: bytes

    @property
    def captured_ns(self) -> int:
        """When it was captured, or else published. What is added comes behind its unit."""
        at_ns = self.stamp.capture_ns if self.unit.dated else self.at_ns
        return at_ns + _BEHIND_NS * self.unit.added


class Joined(NamedTuple):
    """What is to be done when a unit has come.

    live: the unit, for decoders that have begun; None: it is not for them.
    begin: for decoders that wait: they begin with these units now. Empty: they wait on.
    before: the units that were kept and are not among `begin`.
    anew: units before this one were missed, so decoders that have begun wait again from now on.
    """

    live: StreamUnit | None = None
    begin: Sequence[StreamUnit] = ()
    before: Sequence[StreamUnit] = ()
    anew: bool = False


class JoinedUnits:
    """Finds where decoders can begin. Ask the topic's writer for a key picture by `poll_ask`.

    most_ns: units are kept no longer.
    refused: hand over units that the receiver's decoder refused, too. Others may close on one.
    """

    def __init__(self, *, most_ns: int = MOST_KEPT_NS, refused: bool = False) -> None:
        self._most_ns, self._refused = most_ns, refused
        self._kept: list[StreamUnit] = []
        self.kept_octets = 0
        self._next: int | None = None
        self._lacks_sets = False
        self._asked_ns: int | None = None

    def poll_ask(self, now_ns: int, *, waits: bool) -> bool:
        """Return whether to ask for a key picture now, by `Reader.rejoin`."""
        asked_ns = self._asked_ns if waits else None
        asks = waits and (asked_ns is None or now_ns - asked_ns >= _AGAIN_NS)
        self._asked_ns = now_ns if asks else asked_ns
        return asks

    def handle_unit(
        self, unit: CodedUnit, stamp: CaptureStamp, at_ns: int, *, waits: bool
    ) -> Joined:
        """Take the next unit of the topic, published at `at_ns`.

        waits: there are decoders that have not begun.
        """
        number, came = stamp.sequence, StreamUnit(unit, stamp, at_ns, unit.data)
        if unit.added:
            return self._handle_added(came) if waits else Joined()
        begins = unit.key and not unit.damaged
        anew = self._next not in (None, number) and not begins
        before = [] if number == self._next else self.take_kept()
        self._next = number + 1
        return self._handle(came, before, begins=begins, waits=waits or anew)._replace(anew=anew)

    def _handle(
        self, came: StreamUnit, before: list[StreamUnit], *, begins: bool, waits: bool
    ) -> Joined:
        unit = came.unit
        if unit.refused and not self._refused:
            return Joined(before=before)
        live = came
        if self._lacks_sets:
            live, self._lacks_sets = _with_sets(came), False
        if begins:
            return self._begin(live, [live] if waits else (), before + self.take_kept())
        if not waits or unit.codec == "h265":
            return Joined(live, (), before + self.take_kept())
        if self._kept and self._kept[0].unit.added:
            return self._begin(live, [*self.take_kept(), _with_sets(came)], before)
        self._keep(came)
        late = came.at_ns - self._kept[0].at_ns >= self._most_ns
        if late or self.kept_octets > MOST_KEPT_OCTETS:
            before += self.take_kept()
        return Joined(live, (), before)

    def take_kept(self) -> list[StreamUnit]:
        """Give up the units that are kept, and return them."""
        kept, self._kept, self.kept_octets = self._kept, [], 0
        return kept

    def _handle_added(self, key: StreamUnit) -> Joined:
        number = key.stamp.sequence
        if self._next is None:
            # The newest sample of a topic may be an old one: the next unit shows.
            self._keep(key)
            self._next = number + 1
            return Joined()
        first = self._kept[0].stamp.sequence if self._kept else self._next
        if not first - 1 <= number < self._next:
            return Joined()
        kept = self.take_kept()
        before = [each for each in kept if each.stamp.sequence <= number]
        after = kept[len(before) :]
        self._lacks_sets = not after
        return self._begin(None, [key, *map(_with_sets, after[:1]), *after[1:]], before)

    def _begin(
        self, live: StreamUnit | None, begin: Sequence[StreamUnit], before: Sequence[StreamUnit]
    ) -> Joined:
        self._asked_ns = None
        return Joined(live, begin, before)

    def _keep(self, came: StreamUnit) -> None:
        self._kept.append(came)
        self.kept_octets += len(came.data)


class JoinedSequence:
    """One sequence of all units of a stream, in which decoders can begin.

    waits: a decoder has not begun, so units of H.264 wait for its key picture. Those of HEVC do
    not, because the next key picture may be far.
    """

    def __init__(self, *, waits: bool = False, most_ns: int = MOST_KEPT_NS) -> None:
        self._joined = JoinedUnits(most_ns=most_ns, refused=True)
        self.take_kept, self.waits = self._joined.take_kept, waits
        self._codec: VideoCodec = "h264"

    @property
    def holds(self) -> bool:
        """Whether the next unit waits."""
        return self.waits and self._codec == "h264"

    @property
    def kept_octets(self) -> int:
        return self._joined.kept_octets

    def poll_ask(self, now_ns: int) -> bool:
        return self._joined.poll_ask(now_ns, waits=self.waits)

    def handle_unit(self, unit: CodedUnit, stamp: CaptureStamp, at_ns: int) -> Joined:
        """As of `JoinedUnits`; each unit is handed over once, and `before` ahead of the others."""
        self._codec = unit.codec
        joined = self._joined.handle_unit(unit, stamp, at_ns, waits=self.waits)
        self.waits = self.waits or joined.anew
        holds = self.holds
        self.waits = self.waits and not joined.begin
        return joined._replace(live=None) if holds or joined.begin else joined


def _with_sets(came: StreamUnit) -> StreamUnit:
    """The unit after a key picture that was added, which has parameter sets of its own."""
    unit = came.unit
    if parameter_sets_of(unit.data, unit.codec):
        return came
    # Not alone: browsers do not take them for an access unit, and close their decoder.
    return came._replace(data=unit.parameter_sets + unit.data)
