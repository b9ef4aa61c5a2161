"""Haptic samples with the names of their parts."""

from typing import NamedTuple

from telepresence.haptics.sample import Command, Feedback, read_command, read_feedback


class Sample(NamedTuple):
    """A received sample with session number, sequence number (0 to 65535) and flags octet."""

    session: int
    sequence: int
    flags: int
    value: Command | Feedback


def unpack_command(data: bytes) -> Sample:
    """Parse `data`; ProtocolError unless it is exactly one command sample."""
    return Sample(*read_command(data))


def unpack_feedback(data: bytes) -> Sample:
    """Parse `data`; ProtocolError unless it is exactly one feedback sample."""
    return Sample(*read_feedback(data))
