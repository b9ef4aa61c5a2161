"""Haptic samples with the names of their parts."""

from typing import NamedTuple

from telepresence.haptics.sample import Command, Feedback, read_command, read_feedback


class CommandSample(NamedTuple):
    """A received command with session number, sequence number (0 to 65535) and flags octet."""

    session: int
    sequence: int
    flags: int
    value: Command


class FeedbackSample(NamedTuple):
    """A received feedback with session number, sequence number (0 to 65535) and flags octet."""

    session: int
    sequence: int
    flags: int
    value: Feedback


def unpack_command(data: bytes) -> CommandSample:
    """Parse `data`; ProtocolError unless it is exactly one command sample."""
    return CommandSample(*read_command(data))


def unpack_feedback(data: bytes) -> FeedbackSample:
    """Parse `data`; ProtocolError unless it is exactly one feedback sample."""
    return FeedbackSample(*read_feedback(data))
