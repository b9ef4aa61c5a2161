"""Repeats what the other end must have until it says that it has it. One machine for all of TM/TC.

PUS telecommands wait for the report of their end, messages of K2ACI for their acknowledgement,
requests of a process for the answer of its segment's end.
Telemetry that must arrive (ST[01]) needs no machine of its own: a telecommand that comes again has
its reports sent again.

    handle_put ──> WAITING ──poll_transmit──> OPEN ──poll_transmit, after the wait──> OPEN
                      │                        │ │
                      │                        │ └─poll_transmit, after `give_up_ns`──> GIVEN UP
                      └────────────pop─────────┴──> gone (acknowledged or superseded)

WAITING: it was never sent, or the window is full. OPEN: it is under way. The first wait is
`timeout_ns`; each is twice the one before, up to `longest` times as long. A new contact begins
anew.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice
from typing import Generic, TypeVar

_Item = TypeVar("_Item")


@dataclass(slots=True)
class Repeated(Generic[_Item]):
    """An item, and how it was sent so far. tries: 0 while it was never sent."""

    item: _Item
    first_ns: int
    due_ns: int
    wait_ns: int
    tries: int = 0


class Retransmission(Generic[_Item]):
    """Items by number, in the order in which they were put. A core.

    Send what `poll_transmit` returns until None; again at `poll_timeout`. `pop` an item when the
    other end has it. Take those that `next_given_up` names before `poll_transmit`.

    most: items at once, waiting ones included. window: the oldest ones that may be under way.
    give_up_ns: after this time an item that was sent is given up; None: never.
    longest: the longest wait, in `timeout_ns`.
    """

    def __init__(
        self,
        *,
        timeout_ns: int,
        most: int,
        window: int | None = None,
        give_up_ns: int | None = None,
        longest: int = 8,
    ) -> None:
        self.repeated = 0
        self.sent = 0
        self._timeout_ns = timeout_ns
        self._most = most
        self._window = most if window is None else window
        self._give_up_ns = give_up_ns
        self._longest_ns = longest * timeout_ns
        self._next = 0
        self._items: dict[int, Repeated[_Item]] = {}

    def __iter__(self) -> Iterator[tuple[int, Repeated[_Item]]]:
        return iter(list(self._items.items()))

    @property
    def full(self) -> bool:
        """Whether no further item may be put."""
        return len(self._items) >= self._most

    @property
    def numbers(self) -> tuple[int, ...]:
        """The numbers of the items, oldest first."""
        return tuple(self._items)

    def handle_put(self, item: _Item, now_ns: int, number: int | None = None) -> int:
        """Send `item` from now on; return its number. Ask `full` before.

        number: above those before; None: the next one.
        """
        number = self._next if number is None else number
        self._next = number + 1
        self._items[number] = Repeated(item, now_ns, now_ns, self._timeout_ns)
        return number

    def handle_contact(self, now_ns: int) -> None:
        """The signal is acquired: send at once what is open."""
        for one in self._items.values():
            one.due_ns, one.wait_ns = now_ns, self._timeout_ns

    def get(self, number: int) -> Repeated[_Item] | None:
        """Return an item that was sent at least once, or None."""
        one = self._items.get(number)
        return one if one is not None and one.tries else None

    def pop(self, number: int) -> Repeated[_Item] | None:
        """Take an item out, sent or not; None if it is not there."""
        return self._items.pop(number, None)

    def next_given_up(self, now_ns: int) -> int | None:
        """Return the number of an item whose timeout is over, or None; `pop` it."""
        for number, one in self._under_way():
            if self._give_up_ns is None or now_ns < one.due_ns or not one.tries:
                continue
            if now_ns - one.first_ns >= self._give_up_ns:
                return number
        return None

    def poll_transmit(self, now_ns: int) -> tuple[int, Repeated[_Item]] | None:
        """Return the next item to send now, with its number, or None."""
        for number, one in self._under_way():
            if now_ns < one.due_ns:
                continue
            self.repeated += one.tries > 0
            self.sent += 1
            one.tries += 1
            one.due_ns = now_ns + one.wait_ns
            one.wait_ns = min(2 * one.wait_ns, self._longest_ns)
            return number, one
        return None

    def poll_timeout(self) -> int | None:
        """When an item is to be sent or given up; None while nothing is open."""
        return min((one.due_ns for _, one in self._under_way()), default=None)

    def _under_way(self) -> Iterator[tuple[int, Repeated[_Item]]]:
        return islice(self._items.items(), self._window)
