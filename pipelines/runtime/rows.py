"""The rows that processes report, by series: what each value of a row is. Instants are in ns."""

from typing import NamedTuple


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


class SampleRow(NamedTuple):
    """A haptic sample was sent or received."""

    sequence: int
    instant_ns: int


class DurationRow(NamedTuple):
    """How late a cycle began, or how long a slot took."""

    duration_ns: int


class ContactRow(NamedTuple):
    """The stylus touched something; -1 for no LED."""

    instant_ns: int
    led: int


class PerceivedRow(NamedTuple):
    """A light or a click was found. slack_ns: how much earlier it may have been captured."""

    instant_ns: int
    capture_ns: int
    slack_ns: int
    strength: int


class StepRow(NamedTuple):
    """The force stepped at the operator's hand."""

    instant_ns: int


#: By series; of a series "shown.STREAM" the word before the point.
ROWS: dict[str, type[tuple[int, ...]]] = {
    "out": OutRow,
    "tx": TxRow,
    "coding": CodingRow,
    "rx": RxRow,
    "decoded": DecodedRow,
    "shown": ShownRow,
    "haptic_tx": SampleRow,
    "haptic_rx": SampleRow,
    "lateness": DurationRow,
    "sending": DurationRow,
    "contact": ContactRow,
    "light": PerceivedRow,
    "click": PerceivedRow,
    "step": StepRow,
}
#: Values in a row, by series.
WIDTHS = {series: len(row.__annotations__) for series, row in ROWS.items()}
