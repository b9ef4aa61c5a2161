"""GStreamer's voice in the bench: it is heard, and by all that listen.

When it is heard is GStreamer's affair and the machine's: a host that stands still for 30 ms moves
all sound after it by as much, or tears a hole. So each second is sought where it is, and only some
have to be whole.
"""

import numpy as np
import pytest

from pipelines.bench.voice.gstreamer import Peer, listen_live, missing
from pipelines.bench.voice.network import Network
from pipelines.bench.voice.speech import LEAD_IN_BLOCKS, lags, speech_track

pytestmark = pytest.mark.interop


def test_what_is_said_is_heard_by_every_receiver():
    absent = missing()
    if absent is not None:
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
    """How like what was said each whole second of what was heard is: correlation, 0 to 1."""
    found = []
    for second, lag in enumerate(lags(track, heard)):
        begin = second * 48_000 - lag
        said = track.samples[max(begin, 0) : begin + 48_000].astype(float)
        got = heard[max(begin, 0) + lag : begin + lag + 48_000][: len(said)].astype(float)
        # Before the first word and after the last one there is nothing to compare.
        if begin >= LEAD_IN_BLOCKS * 960 and len(got) == 48_000 and said.any() and got.any():
            found.append(np.corrcoef(said, got)[0, 1])
    return found
