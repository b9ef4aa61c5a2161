"""What the microphones hear: a voice, the room, and the stylus when it meets the wall."""

from functools import lru_cache
from typing import Literal, TypeVar

import numpy as np
from numpy.typing import NDArray

from kontur_av.clock import NS_PER_S
from kontur_av.media import AUDIO_CLOCK_HZ, Pcm
from telepresence.world.state import StateAt

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


#: RMS levels of the room and the fan, and the peak of the click, all in counts of int16.
ROOM_LEVEL = 22.0
FAN_LEVEL = 120.0
CLICK_PEAK = 16000.0
CLICK_S = 0.030

_NOISE_SAMPLES = 7 * AUDIO_CLOCK_HZ

_Number = TypeVar("_Number", np.int16, np.float64)


class Room:
    """The sound of one place, block by block; it depends only on time and on the world's state.

    speech: the voice in it. fan: add ventilation, as in the station.
    state_at: where the stylus's clicks come from; None for a place without clicks.
    """

    def __init__(self, speech: Speech, *, fan: bool, state_at: StateAt | None, seed: int) -> None:
        self._speech = speech
        self._state_at = state_at
        self._noise = _ventilation(seed) if fan else _hiss(seed)
        self._click = _click(seed)
        self._touched_ns: int | None = None
        self._begun = False
        self._tail: NDArray[np.float64] = np.zeros(0)

    def fill(self, samples: Pcm, sequence: int, capture_ns: int) -> None:
        """Fill `samples` (int16) with the block whose first sample is captured at `capture_ns`."""
        count = len(samples)
        begin = self._speech.position_at(capture_ns)
        mixed = _looped(self._speech.samples, begin, count).astype(np.float64)
        at = capture_ns * AUDIO_CLOCK_HZ // NS_PER_S % _NOISE_SAMPLES
        mixed += _looped(self._noise, at, count)
        if self._state_at is not None:
            self._add_clicks(mixed, capture_ns, self._state_at)
        np.maximum(mixed, -32768, out=mixed)
        np.minimum(mixed, 32767, out=mixed)
        samples[:] = mixed

    def _add_clicks(self, mixed: NDArray[np.float64], capture_ns: int, state_at: StateAt) -> None:
        count = len(mixed)
        state = state_at(capture_ns + count * NS_PER_S // AUDIO_CLOCK_HZ)
        touched_ns = state.click_ns
        # The first sample at or after the contact.
        late_ns = 0 if touched_ns is None else capture_ns - touched_ns
        begin = -(late_ns * AUDIO_CLOCK_HZ // NS_PER_S)
        begun, self._begun = self._begun, True
        # A click that begins after this block belongs to the next one.
        clicks = touched_ns is not None and touched_ns != self._touched_ns and begin < count
        if not clicks and not len(self._tail):
            return  # as most blocks
        sounding = np.zeros(max(count + len(self._click), len(self._tail)))
        sounding[: len(self._tail)] = self._tail
        if clicks:
            if begin >= 0:
                sounding[begin : begin + len(self._click)] += self._click
            elif begun:
                # The contact was reported late: play the rest of the click at its right time.
                rest = self._click[-begin:]
                sounding[: len(rest)] += rest
            self._touched_ns = touched_ns
        mixed += sounding[:count]
        tail = sounding[count:]
        self._tail = tail if tail.any() else np.zeros(0)


def _looped(sound: NDArray[_Number], at: int, count: int) -> NDArray[_Number]:
    if at + count <= len(sound):
        return sound[at : at + count]
    return np.take(sound, np.arange(at, at + count), mode="wrap")


def _click(seed: int) -> NDArray[np.float64]:
    """Return steel on steel: two damped tones and some noise."""
    t = np.arange(int(CLICK_S * AUDIO_CLOCK_HZ)) / AUDIO_CLOCK_HZ
    noise = np.random.default_rng(seed).normal(0, 0.25, len(t))
    ring = np.sin(2 * np.pi * 2100 * t) + 0.6 * np.sin(2 * np.pi * 3370 * t)
    click = ring * np.exp(-t / 0.005) + noise * np.exp(-t / 0.0015)
    return np.asarray(click * (CLICK_PEAK / np.abs(click).max()))


@lru_cache(maxsize=4)
def _hiss(seed: int) -> NDArray[np.float64]:
    return np.random.default_rng(seed).normal(0, ROOM_LEVEL, _NOISE_SAMPLES)


@lru_cache(maxsize=4)
def _ventilation(seed: int) -> NDArray[np.float64]:
    """Return noise with more low frequencies, and the fans' hum; it loops without a step."""
    spectrum = np.fft.rfft(np.random.default_rng(seed).normal(0, 1, _NOISE_SAMPLES))
    hertz = np.fft.rfftfreq(_NOISE_SAMPLES, 1 / AUDIO_CLOCK_HZ)
    noise = np.fft.irfft(spectrum / (1 + (hertz / 260) ** 2) ** 0.5, _NOISE_SAMPLES)
    noise *= FAN_LEVEL / noise.std()
    t = np.arange(_NOISE_SAMPLES) / AUDIO_CLOCK_HZ
    hum = np.sin(2 * np.pi * 117 * t) + 0.5 * np.sin(2 * np.pi * 234 * t)
    return np.asarray(noise + 0.6 * FAN_LEVEL * hum)
