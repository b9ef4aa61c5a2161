"""GStreamer's voice in the bench: every receiver hears it.

When it is heard depends on GStreamer and the machine. A host that stalls for 30 ms shifts all
later sound by as much, or leaves a gap. So each second is searched around its place, and only some
must be complete.
"""

import numpy as np
import pytest
from programs import needs

from benchmarks.voice.gstreamer import Peer, listen_live, missing
from benchmarks.voice.network import Network
from benchmarks.voice.speech import LEAD_IN_BLOCKS, lags, speech_track

pytestmark = pytest.mark.interop


def test_every_receiver_hears_the_speech():
    needs("gst-launch-1.0")
    if (absent := missing()) is not None:
        pytest.skip(absent)
    track = speech_track(1)
    peers = [Peer(Network(loss=0.0), 40), Peer(Network(loss=0.1), 40)]
    whole, lossy = listen_live(track, 8_000, peers)
    assert whole.packets >= track.blocks - 5
    assert whole.payload_octets == 19 * whole.packets
    for heard in (whole, lossy):
        assert heard.mouth_to_ear_ns
        assert len(heard.samples) >= 0.9 * len(track.samples)
    assert max(likenesses(track, whole.samples)) > 0.5


def likenesses(track, heard):
    """Return the correlation, 0 to 1, of each whole second of what was heard with the original."""
    found = []
    for second, lag in enumerate(lags(track, heard)):
        begin = second * 48_000 - lag
        said = track.samples[max(begin, 0) : begin + 48_000].astype(float)
        got = heard[max(begin, 0) + lag : begin + lag + 48_000][: len(said)].astype(float)
        # Before the first word and after the last one there is nothing to compare.
        if begin >= LEAD_IN_BLOCKS * 960 and len(got) == 48_000 and said.any() and got.any():
            found.append(np.corrcoef(said, got)[0, 1])
    return found
