"""Whether both directions of the radio carry, as far as one end can know."""

from pipelines.seats.texts import RadioText
from pipelines.session.setup.segments import Segment

_PEER = {Segment.SPACE: "the ground", Segment.GROUND: "space"}


def radio_text(
    segment: Segment, *, hears: bool | None, heard: bool | None, unverified: int
) -> RadioText:
    """Return what to say at an end.

    hears: good frames of the peer arrive here. heard: the peer said so of ours in its newest
    report. None: not known. unverified: telecommands in a row that nobody acknowledged.
    """
    peer = _PEER[segment]
    sent = f" The last {unverified} were not acknowledged." if unverified > 1 else ""
    if hears is False:
        words = f"Nothing arrives from {peer}: telecommands go out unacknowledged.{sent}"
        return RadioText(level="bad", words=words)
    if hears and heard is False:
        words = f"{peer.capitalize()} does not hear us: telecommands do not arrive there.{sent}"
        return RadioText(level="bad", words=words)
    if unverified:
        count = "telecommand was" if unverified == 1 else f"{unverified} telecommands were"
        return RadioText(level="warn", words=f"The last {count} not acknowledged by {peer}.")
    if hears is None:
        return RadioText(level="none", words="Not known yet.")
    return RadioText(level="good", words="Both directions carry.")
