"""The speech of the voice bench, and the quality of what was heard."""

from dataclasses import dataclass
from importlib import import_module
from importlib.util import find_spec

import av
import numpy as np
from numpy.typing import NDArray

from kontur_av.media import AUDIO_CLOCK_HZ, BLOCK_SAMPLES, Pcm
from telepresence.world.scenes import read_speech
from telepresence.world.sound import Speaker

#: The sample rate of wide-band PESQ (ITU-T P.862.2).
_PESQ_HZ = 16_000
#: Silence before the first word: the ends start up in it, and lose nothing.
LEAD_IN_BLOCKS = 50
_SPEAKERS: tuple[Speaker, Speaker] = ("ground", "cabin")
_WINDOW = AUDIO_CLOCK_HZ
_FARTHEST = 2 * AUDIO_CLOCK_HZ
#: A window with a lower correlation tells nothing about its delay.
_ALIKE = 0.5


@dataclass(frozen=True)
class Track:
    """samples: the speech, whole blocks. turns: begin and end of each speaker's turn."""

    samples: Pcm
    turns: tuple[tuple[int, int], ...]

    @property
    def blocks(self) -> int:
        return len(self.samples) // BLOCK_SAMPLES


def speech_track(seconds: float) -> Track:
    """The two speakers of `samples/media` in turn, whole turns, for at least `seconds`."""
    pieces: list[Pcm] = [np.zeros(LEAD_IN_BLOCKS * BLOCK_SAMPLES, np.int16)]
    turns: list[tuple[int, int]] = []
    at = len(pieces[0])
    while at < seconds * AUDIO_CLOCK_HZ or not turns:
        said = read_speech(_SPEAKERS[len(turns) % len(_SPEAKERS)]).samples
        said = said[: len(said) // BLOCK_SAMPLES * BLOCK_SAMPLES]
        turns.append((at, at + len(said)))
        pieces.append(said)
        at += len(said)
    # Silence at the end, so that the last word is played.
    pieces.append(np.zeros(LEAD_IN_BLOCKS * BLOCK_SAMPLES, np.int16))
    return Track(np.concatenate(pieces), tuple(turns))


def pesq_is_there() -> bool:
    """Whether quality can be measured: the package `pesq` comes with the extra `bench`."""
    return find_spec("pesq") is not None


def quality(track: Track, heard: Pcm, lag_samples: int) -> list[float]:
    """PESQ's MOS-LQO (ITU-T P.862.2, 1.0 to 4.6) of each turn that is not silent in `heard`.

    heard: its sample k + lag_samples corresponds to sample k of the track; PESQ itself aligns
    variations of the delay.
    """
    pesq = import_module("pesq").pesq
    found = []
    for begin, end in track.turns:
        got = _cut(heard, begin + lag_samples, end + lag_samples)
        reference, degraded = _at_16_khz(track.samples[begin:end]), _at_16_khz(got)
        if degraded.any():
            found.append(float(pesq(_PESQ_HZ, reference, degraded, "wb")))
    return found


def _cut(sound: Pcm, begin: int, end: int) -> Pcm:
    """From `begin` to `end`, with silence outside the sound."""
    room = np.zeros(end - begin, np.int16)
    part = sound[max(begin, 0) : max(end, 0)]
    at = max(-begin, 0)
    room[at : at + len(part)] = part
    return room


def _at_16_khz(sound: Pcm) -> Pcm:
    resampler = av.AudioResampler("s16", "mono", _PESQ_HZ)
    frame = av.AudioFrame.from_ndarray(sound[np.newaxis], format="s16", layout="mono")
    frame.sample_rate = AUDIO_CLOCK_HZ
    pieces = [piece.to_ndarray().reshape(-1) for piece in resampler.resample(frame)]
    pieces += [piece.to_ndarray().reshape(-1) for piece in resampler.resample(None)]
    return np.concatenate(pieces).astype(np.int16)


def lags(track: Track, heard: Pcm) -> list[int]:
    """The lag of each second of `heard` behind the track, in samples.

    By correlation with the track; a second without a clear match has the lag of the one before.
    """
    # Search no farther, because the speakers repeat themselves.
    whole = _best_shift(track.samples, heard, -_FARTHEST, _FARTHEST)
    found, last = [], whole
    for begin in range(0, len(heard), _WINDOW):
        window = heard[begin : begin + _WINDOW]
        reach = AUDIO_CLOCK_HZ // 5
        said = _cut(track.samples, begin - whole - reach, begin - whole + _WINDOW + reach)
        shift = _best_shift(said, window, -2 * reach, 0)
        part = _cut(said, -shift, -shift + len(window))
        if _likeness(part, window) >= _ALIKE:
            last = shift + whole + reach
        found.append(last)
    return found


def _best_shift(said: Pcm, heard: Pcm, least: int, most: int) -> int:
    """The shift s from `least` to `most` with the best correlation of heard[k + s] and said[k]."""
    size = 1 << (len(said) + len(heard)).bit_length()
    product = np.fft.irfft(
        np.fft.rfft(heard.astype(np.float64), size)
        * np.conj(np.fft.rfft(said.astype(np.float64), size)),
        size,
    )
    shifts = np.arange(least, most + 1)
    return int(shifts[np.argmax(product[shifts])])


def _likeness(one: NDArray[np.int16], other: NDArray[np.int16]) -> float:
    a, b = one.astype(np.float64), other.astype(np.float64)
    power = float(np.sqrt((a @ a) * (b @ b)))
    return float(a @ b) / power if power else 0.0
