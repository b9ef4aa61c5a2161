"""What a jitter buffer gives out, and what it counts."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class PlayoutBlock:
    """One block of sound whose time has come. A `VoicePlayer` makes it sound.

    payload: an Opus packet, or None: the decoder conceals `samples` samples.
    timestamp: its 32-bit RTP timestamp.  play_ns: when its first sample is due.
    samples: what it stands for.  played_samples: in the time of how many it is played.
    recovered: `payload` is the packet after the missing one, and holds a copy of it.
    inserted: it stands for nothing that was sent: it fills the time in which the delay grows.
    """

    payload: bytes | None
    timestamp: int
    samples: int
    play_ns: int
    played_samples: int
    recovered: bool = False
    inserted: bool = False


@dataclass(slots=True)
class PlayoutCounts:
    """played: blocks given out with sound.  recovered: with that of a copy.  concealed: without.
    inserted: filled in where the delay grew.  stretched, shortened: blocks that were.
    late: came after their time.  dropped: pushed out of a full buffer,
    or left out after a silence or a stall, because all that follows would have been late as well.
    garbage: no Opus.  resyncs: new time lines.
    """

    played: int = 0
    recovered: int = 0
    concealed: int = 0
    inserted: int = 0
    stretched: int = 0
    shortened: int = 0
    late: int = 0
    dropped: int = 0
    garbage: int = 0
    resyncs: int = 0
