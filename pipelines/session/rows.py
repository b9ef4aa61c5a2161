"""The rows that processes report: single events, such as packets. Instants are in ns.

A row's type names its series, so two series with the same columns have a type each.
"""

from typing import NamedTuple, get_args


class OutRow(NamedTuple):
    """A packet left its sender; the cap that held then."""

    sent_ns: int
    octets: int
    cap_bps: int


class TxRow(NamedTuple):
    """An access unit or a block of sound was sent."""

    timestamp: int
    capture_ns: int
    encoded_ns: int
    sent_ns: int


class CodingRow(NamedTuple):
    """A picture came to the encoder, and was encoded."""

    timestamp: int
    came_ns: int
    begun_ns: int
    octets: int
    packets: int


class RxRow(NamedTuple):
    """The last packet of a unit was received."""

    timestamp: int
    received_ns: int


class DecodedRow(NamedTuple):
    """A picture was decoded."""

    timestamp: int
    decoded_ns: int


class ShownRow(NamedTuple):
    """A picture or a block of sound came to its display."""

    timestamp: int
    capture_ns: int
    displayed_ns: int


class SampleSentRow(NamedTuple):
    """A haptic sample was sent."""

    sequence: int
    sent_ns: int


class SampleReceivedRow(NamedTuple):
    """A haptic sample was received."""

    sequence: int
    received_ns: int


class LatenessRow(NamedTuple):
    """How late a cycle began."""

    lateness_ns: int


class SendingRow(NamedTuple):
    """From a slot's deadline to the instant at which its frame had been sent."""

    duration_ns: int


class ContactRow(NamedTuple):
    """The stylus touched something; -1 for no LED."""

    instant_ns: int
    led: int


class LightRow(NamedTuple):
    """A light was found. slack_ns: how much earlier it may have been captured."""

    instant_ns: int
    capture_ns: int
    slack_ns: int
    strength: int


class ClickRow(NamedTuple):
    """A click was found. slack_ns: how much earlier it may have been captured."""

    instant_ns: int
    capture_ns: int
    slack_ns: int
    strength: int


class StepRow(NamedTuple):
    """The force stepped at the operator's hand."""

    instant_ns: int


class ClockRow(NamedTuple):
    """Where the other machine's clock was, both as wall time at their start (`ClockFigures`)."""

    instant_ns: int
    offset_ns: int
    error_ns: int


#: Any of them.
Row = (
    OutRow
    | TxRow
    | CodingRow
    | RxRow
    | DecodedRow
    | ShownRow
    | SampleSentRow
    | SampleReceivedRow
    | LatenessRow
    | SendingRow
    | ContactRow
    | LightRow
    | ClickRow
    | StepRow
    | ClockRow
)

_INSTANTS = {
    *("sent_ns", "capture_ns", "encoded_ns", "came_ns", "begun_ns", "received_ns", "decoded_ns"),
    *("displayed_ns", "instant_ns"),
}
#: The columns that are instants of the clock of the process that tells the row.
INSTANTS: dict[type[Row], tuple[str, ...]] = {
    kind: tuple(column for column in kind._fields if column in _INSTANTS) for kind in get_args(Row)
}


class SampleNumbers:
    """Counts the samples of topics that were gone before they were read."""

    def __init__(self) -> None:
        #: By topic: the number of its newest sample.
        self._newest: dict[str, int] = {}

    def __contains__(self, topic: str) -> bool:
        return topic in self._newest

    def forget(self, topic: str) -> None:
        self._newest.pop(topic, None)

    def handle_sample(self, topic: str, sequence: int) -> int:
        """Return how many samples are missing ahead of this one."""
        before = self._newest.get(topic)
        self._newest[topic] = sequence
        # A smaller number is that of a writer that was started again.
        return 0 if before is None else max(0, sequence - before - 1)
