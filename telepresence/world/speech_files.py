"""Reads the two speech samples from their files. A shell."""

from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kontur_av.errors import ConfigError
from kontur_av.media import AUDIO_CLOCK_HZ
from telepresence.world.speech import Speaker, Speech


def media_folder() -> Path:
    """Return the folder of the sample media: in the installed package, or in the checkout."""
    package = Path(__file__).resolve().parents[1]
    for folder in (package / "media", package.parent / "samples" / "media"):
        if (folder / "speech_ground.flac").is_file():
            return folder
    raise ConfigError("the speech samples are missing: run `python samples/make_speech.py`")


@lru_cache(maxsize=2)
def read_speech(speaker: Speaker) -> Speech:
    """Return a speaker's sample, which all callers share. ConfigError if its file is missing."""
    # Imported on demand, because only processes with speech need FFmpeg.
    import av

    resampler = av.AudioResampler("s16", "mono", AUDIO_CLOCK_HZ)
    pieces: list[NDArray[np.generic]] = []
    with av.open(str(media_folder() / f"speech_{speaker}.flac")) as container:
        for frame in container.decode(audio=0):
            pieces += (piece.to_ndarray().reshape(-1) for piece in resampler.resample(frame))
    pieces += (piece.to_ndarray().reshape(-1) for piece in resampler.resample(None))
    return Speech(np.concatenate(pieces).astype(np.int16, copy=False))
