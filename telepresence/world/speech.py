"""Speech of the built-in scenes: what is spoken at an instant, and how loud it is."""

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from kontur_av.clock import NS_PER_S
from kontur_av.media import AUDIO_CLOCK_HZ, Pcm

Speaker = Literal["ground", "cabin"]

_WINDOW = AUDIO_CLOCK_HZ // 50


class Speech:
    """A sample of speech that is spoken again and again, from the clock's zero on.

    samples: (n,) int16 at 48 kHz; at least 20 ms.
    """

    def __init__(self, samples: Pcm) -> None:
        self.samples = samples
        self._envelope: NDArray[np.float64] | None = None

    def position_at(self, instant_ns: int) -> int:
        """Return the index of the sample that is spoken at an instant, equal in every process.

        The speaker's picture and voice thus match, although independent processes produce them.
        """
        return instant_ns * AUDIO_CLOCK_HZ // NS_PER_S % len(self.samples)

    def loudness_at(self, instant_ns: int) -> float:
        """Return the loudness at an instant, smoothed over 20 ms: 0.0 to 1.0."""
        if self._envelope is None:
            # Computed on demand, because only pictures need it.
            self._envelope = _envelope(self.samples)
        return float(self._envelope[self.position_at(instant_ns) // _WINDOW % len(self._envelope)])


def _envelope(samples: Pcm) -> NDArray[np.float64]:
    windows = samples[: len(samples) // _WINDOW * _WINDOW].reshape(-1, _WINDOW)
    level = np.sqrt((windows.astype(np.float64) ** 2).mean(axis=1))
    return np.asarray(np.minimum(level / np.percentile(level, 97), 1.0) ** 0.7)
