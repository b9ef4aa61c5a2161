"""Which telecommands of another ground system are new, though their counts are known. A core."""

from collections import OrderedDict
from dataclasses import dataclass, field, replace

from kontur_av.clock import NS_PER_S
from telepresence.tmtc.pus.packets import Telecommand
from telepresence.tmtc.pus.user import EDITIONS
from telepresence.tmtc.pus.verification import Verification

#: An application knows a telecommand for 60 s, after up to 30 s on the way.
_KEPT_NS = 120 * NS_PER_S
_KEPT_DEPTH = 512


@dataclass(slots=True)
class _Passed:
    """senders: connections that sent it. unheard: those of them that may not know of its end.

    ended: the report of the end of the newest copy was handed to all connections.
    """

    edition: int
    at_ns: int
    senders: set[int] = field(default_factory=set)
    unheard: set[int] = field(default_factory=set)
    ended: bool = False


class CommandEditions:
    """Tells a telecommand that is repeated from an equal one of a system that began anew.

    A ground system that was started again counts anew, so its telecommands may equal those of its
    last life. One is repeated as long as its sender may not know what became of it. So it is new if
    each connection that sent it has the report of its end, and another one sends it. The new one
    gets the next number, its edition. By it the application tells the two apart.

    Ask `edition_of` for each telecommand that is passed on. Say with `handle_end` which report is
    handed to the connections, and with `handle_heard` which of them has all that was handed to it.
    """

    def __init__(self) -> None:
        self._passed: OrderedDict[Telecommand, _Passed] = OrderedDict()

    def edition_of(self, command: Telecommand, connection: int, now_ns: int) -> int:
        """Return 0 to `EDITIONS` - 1; that of the last equal one for a repetition."""
        while self._passed and now_ns - next(iter(self._passed.values())).at_ns > _KEPT_NS:
            self._passed.popitem(last=False)
        key = replace(command, source=0, flags=0)
        passed = self._passed.get(key)
        if passed is None:
            passed = _Passed(0, now_ns)
        elif not passed.unheard and connection not in passed.senders:
            passed = _Passed((passed.edition + 1) % EDITIONS, now_ns)
        passed.at_ns = now_ns
        # Each copy is verified, and the earlier report may have missed this connection.
        passed.ended = False
        passed.senders.add(connection)
        passed.unheard.add(connection)
        self._passed[key] = passed
        self._passed.move_to_end(key)
        if len(self._passed) > _KEPT_DEPTH:
            self._passed.popitem(last=False)
        return passed.edition

    def handle_end(self, report: Verification, edition: int) -> None:
        """A report of an end goes to all connections."""
        about = (report.apid, report.count, edition)
        for command, passed in self._passed.items():
            if (command.apid, command.count, passed.edition) == about:
                passed.ended = True

    def handle_heard(self, connection: int) -> None:
        """The other side has acknowledged all octets that were put before."""
        for passed in self._passed.values():
            if passed.ended:
                passed.unheard.discard(connection)
