"""GStreamer's voice in the bench: it is heard, and later than ours."""

import pytest

from pipelines.bench.voice_gstreamer import Peer, listen_live, missing
from pipelines.bench.voice_network import Network
from pipelines.bench.voice_speech import lags, speech_track

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
        # Sound that is like what was said, and of its length.
        assert len(heard.samples) >= 0.9 * len(track.samples)
    # Before the first word there is nothing to compare.
    found = lags(track, whole.samples)[2:-2]
    assert max(found) - min(found) < 48
