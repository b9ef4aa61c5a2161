"""The duration of each step of coding on virtual time."""

from dataclasses import asdict, dataclass

from kontur_av.clock import NS_PER_MS
from kontur_av.errors import ConfigError


@dataclass(frozen=True, kw_only=True)
class CodingCosts:
    """Fixed durations in ms: medians of live sessions on two cores.

    capture_ms: from the capture of a picture to its arrival at the encoder: drawing, the stereo
        merge, the selector, and three wake-ups.
    encode_ms, decode_ms: of one picture, its wake-up included.
    voice_encode_ms, voice_decode_ms: of one block of sound.
    """

    capture_ms: float = 4.0
    encode_ms: float = 6.0
    decode_ms: float = 3.0
    voice_encode_ms: float = 1.7
    voice_decode_ms: float = 0.3

    def __post_init__(self) -> None:
        for name, value in asdict(self).items():
            if not 0 <= value <= 1000:
                option = f"--{name.replace('_', '-')}"
                raise ConfigError(f"{option} {value:g}: take 0 to 1000 milliseconds")

    def ns(self, name: str) -> int:
        """Return the duration `name` in ns, at least 1, so that an effect follows its cause."""
        cost_ms: float = getattr(self, f"{name}_ms")
        return max(1, round(cost_ms * NS_PER_MS))
