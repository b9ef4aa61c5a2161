"""`python -m benchmarks voice`: reproducible figures, and the parts that they come from."""

import numpy as np
import pytest

from benchmarks.voice.gstreamer import laid_out
from benchmarks.voice.network import BURST_PACKETS, Network


def test_loss_is_as_configured_and_a_sound_is_laid_out_as_a_sound_card_plays_it():
    for loss in (0.02, 0.1):
        assert len(Network(loss=loss).lost(20_000, spared=50)) / 20_000 == pytest.approx(
            loss, rel=0.15
        )
        lost = Network(loss=loss, bursts=True).lost(60_000, spared=50)
        assert len(lost) / 60_000 == pytest.approx(loss, rel=0.15)
        bursts = sum(number - 1 not in lost for number in lost)
        assert len(lost) / bursts == pytest.approx(BURST_PACKETS, rel=0.15)
        assert min(lost) >= 50
    assert Network(loss=0.0).lost(1000, spared=0) == frozenset()
    first = 2**32 - 500  # the timestamps go round
    block = np.arange(1, 961, dtype=np.int16)

    def arrivals(*timestamps):
        return [
            (10 * i, (first + timestamp) % 2**32, block) for i, timestamp in enumerate(timestamps)
        ]

    sound, places = laid_out(arrivals(0, 960 + 1900, 1920 - 900))
    assert np.array_equal(sound, np.tile(block, 3))
    assert places == [(0, 0), (10, 960), (20, 1920)]
    sound, places = laid_out(arrivals(0, 960 + 1921, 1920 + 1921))
    assert np.array_equal(sound, np.concatenate([block, np.zeros(1921, np.int16), block, block]))
    assert places == [(0, 0), (10, 2881), (20, 3841)]
