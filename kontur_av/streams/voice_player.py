"""Playout blocks to sound without a gap: decoded, recovered or concealed, and stretched."""

import numpy as np
from numpy.typing import NDArray

from kontur_av.codecs.opus import OpusDecoder
from kontur_av.errors import ProtocolError
from kontur_av.media import Pcm
from kontur_av.rtp.playout import PlayoutBlock

#: Samples of the block before that a cubic needs. They delay sound by two samples (42 µs).
_TAIL = 3
#: A change of length by more than this part happens in pauses only. There missing sound cannot be
#: heard, but another pitch could be.
_RESAMPLED = 40


class VoicePlayer:
    """Turns each block of a `PlayoutBuffer`, in order, into exactly `played_samples` samples."""

    def __init__(self) -> None:
        self._decoder = OpusDecoder()
        self._tail: NDArray[np.int16] = np.zeros(_TAIL, np.int16)

    def play(self, block: PlayoutBlock) -> tuple[Pcm, bool]:
        """Return the block's sound, int16, shape (block.played_samples,), and whether it is real.

        False: it is concealment, because the packet was lost or no Opus.
        """
        sound = self._received(block)
        if sound is not None:
            return self._fitted(sound, block.played_samples), True
        # libopus conceals in steps of 2.5 ms only; the rest is cut off.
        sound = self._decoder.conceal(-(-block.samples // 120) * 120)[: block.samples]
        return self._fitted(sound, block.played_samples), False

    def _received(self, block: PlayoutBlock) -> Pcm | None:
        if block.payload is None:
            return None
        try:
            if block.recovered:
                return self._decoder.recover(block.payload, block.samples)
            return self._decoder.decode(block.payload)
        except ProtocolError:
            return None

    def _fitted(self, sound: Pcm, count: int) -> Pcm:
        """Return `sound` resampled to `count` samples by Catmull-Rom interpolation."""
        line = np.concatenate([self._tail, sound])
        self._tail = line[-_TAIL:]
        if count == len(sound):
            return line[1 : 1 + count]
        if abs(count - len(sound)) > len(sound) // _RESAMPLED:
            return _blended(line[1 : 1 + len(sound)], count)
        at = 1 + np.arange(count) * (len(sound) / count)
        index = at.astype(np.int64)
        t = at - index
        p0, p1, p2, p3 = (line[index + k].astype(np.float64) for k in (-1, 0, 1, 2))
        curve = p1 + 0.5 * t * (
            p2 - p0 + t * (2 * p0 - 5 * p1 + 4 * p2 - p3 + t * (3 * (p1 - p2) + p3 - p0))
        )
        return np.clip(np.rint(curve), -32768, 32767).astype(np.int16)


def _blended(sound: Pcm, count: int) -> Pcm:
    """Return `sound` in `count` samples: its beginning fades into its end where they overlap."""
    length = len(sound)
    begin, end = max(0, count - length), min(length, count)
    weight = (np.arange(begin, end) - begin + 0.5) / (end - begin)
    blended = np.empty(count, np.int16)
    blended[:begin] = sound[:begin]
    blended[end:] = sound[end - count :] if end < count else sound[:0]
    head, tail = sound[begin:end], sound[length - count + begin : length - count + end]
    blended[begin:end] = np.rint(head * (1 - weight) + tail * weight)
    return blended
