"""How far apart two senses may be before people notice, with the sources."""

from dataclasses import dataclass

from kontur_av.clock import NS_PER_MS
from kontur_av.streams.lipsync import EARLIEST_NS, LATEST_NS


@dataclass(frozen=True, kw_only=True)
class Limit:
    """The first sense may come from `least_ns` to `most_ns` after the second one."""

    least_ns: int
    most_ns: int
    source: str

    def holds(self, skew_ns: int) -> bool:
        """Whether a skew, positive if the first sense is late, goes unnoticed."""
        return self.least_ns <= skew_ns <= self.most_ns


#: By the names of the skews in the report.
LIMITS = {
    # Touch up to 50 ms after sight, but only 15 ms before it.
    "video_haptic": Limit(
        least_ns=-50 * NS_PER_MS,
        most_ns=15 * NS_PER_MS,
        source="Di Luca and Mahnan, World Haptics 2019",
    ),
    "audio_haptic": Limit(
        least_ns=-24 * NS_PER_MS, most_ns=24 * NS_PER_MS, source="Adelstein et al., 2003"
    ),
    "audio_video": Limit(least_ns=-EARLIEST_NS, most_ns=LATEST_NS, source="ITU-R BT.1359"),
}
