"""The two speech samples: where they are, and what is spoken at an instant."""

from functools import lru_cache
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from kontur_av.clock import NS_PER_S
from kontur_av.errors import ConfigError
from kontur_av.media import AUDIO_CLOCK_HZ, Pcm

Speaker = Literal["ground", "cabin"]

_WINDOW = AUDIO_CLOCK_HZ // 50


def media_folder() -> Path:
    """Return the folder of the sample media: in the installed package, or in the checkout."""
    package = Path(__file__).resolve().parents[1]
    for folder in (package / "media", package.parent / "samples" / "media"):
        if (folder / "speech_ground.flac").is_file():
            return folder
    raise ConfigError("the speech samples are missing: run `python samples/make_speech.py`")


@lru_cache(maxsize=2)
def speech(speaker: Speaker) -> Pcm:
    """Return the whole sample: (n,) int16 at 48 kHz. Read-only, because all callers share it."""
    # Imported on demand, because only processes with speech need FFmpeg.
    import av

    resampler = av.AudioResampler("s16", "mono", AUDIO_CLOCK_HZ)
    pieces: list[NDArray[np.generic]] = []
    with av.open(str(media_folder() / f"speech_{speaker}.flac")) as container:
        for frame in container.decode(audio=0):
            pieces += (piece.to_ndarray().reshape(-1) for piece in resampler.resample(frame))
    pieces += (piece.to_ndarray().reshape(-1) for piece in resampler.resample(None))
    return np.concatenate(pieces).astype(np.int16, copy=False)


def position_at(speaker: Speaker, instant_ns: int) -> int:
    """Return the index of the sample that is spoken at an instant, equal in every process.

    The speaker's picture and voice thus match, although independent processes produce them.
    """
    return instant_ns * AUDIO_CLOCK_HZ // NS_PER_S % len(speech(speaker))


def loudness_at(speaker: Speaker, instant_ns: int) -> float:
    """Return the loudness of speech at an instant, smoothed over 20 ms: 0.0 to 1.0."""
    envelope = _envelope(speaker)
    return float(envelope[position_at(speaker, instant_ns) // _WINDOW % len(envelope)])


@lru_cache(maxsize=2)
def _envelope(speaker: Speaker) -> NDArray[np.float64]:
    samples = speech(speaker)
    windows = samples[: len(samples) // _WINDOW * _WINDOW].reshape(-1, _WINDOW)
    level = np.sqrt((windows.astype(np.float64) ** 2).mean(axis=1))
    return np.asarray(np.minimum(level / np.percentile(level, 97), 1.0) ** 0.7)
