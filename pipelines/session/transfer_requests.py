"""What the file transfer of an end is asked, and the answers in words. A core."""

import msgspec

from pipelines.session.setup.segments import Segment

STATE, CANCEL, STATUS = "state", "cancel", "status"


def socket_name(segment: Segment) -> str:
    return f"files.{segment.value}"


class FileRequest(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """A request. first, second: names in the directories. number: of a transfer."""

    file: str
    first: str = ""
    second: str = ""
    number: int = -1


class TransferNow(msgspec.Struct, frozen=True, kw_only=True):
    """A transfer under way. octets, size: as of `FileAnswer`. first: the name of its file."""

    number: int
    kind: str
    state: str
    octets: int
    size: int
    first: str


class FileAnswer(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True, tag=True):
    """An answer. number: of the transfer, with which `state` asks how far it is.

    octets: transferred so far. size: of the file; -1 if it is not known. transfers: those under way
    that were asked for at this end, the oldest first. more: how many of them are left out.
    """

    text: str = ""
    number: int = -1
    state: str = ""
    octets: int = 0
    size: int = -1
    transfers: tuple[TransferNow, ...] = ()
    more: int = 0


def progress(answer: FileAnswer) -> str:
    return f"{_octets(answer)} octets"


def _octets(one: FileAnswer | TransferNow) -> str:
    return f"{one.octets}{f' of {one.size}' if one.size >= 0 else ''}"


def listing(answer: FileAnswer) -> str:
    """A line for each transfer under way."""
    if not answer.transfers:
        return "nothing is under way"
    lines = [f"{'number':<11} {'what':<7} {'state':<9} {'octets':>16}  name"]
    for one in answer.transfers:
        octets = _octets(one)
        lines.append(f"{one.number:<11} {one.kind:<7} {one.state:<9} {octets:>16}  {one.first}")
    return "\n".join([*lines, *([f"and {answer.more} more"] if answer.more else [])])
