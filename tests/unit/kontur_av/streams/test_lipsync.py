"""Lip-sync: how long sound waits for pictures."""

import pytest

from kontur_av.clock import NS_PER_MS as MS
from kontur_av.streams.lipsync import EARLIEST_NS, LipSync

#: When the last of 60 pictures is shown.
LAST_NS = 33 * 59 * MS


def least_ms(latencies_ms, at_ns=LAST_NS):
    """Return the least latency of sound after pictures of these latencies, one every 33 ms."""
    lip_sync = LipSync(oldest_picture_ns=300 * MS, oldest_sound_ns=150 * MS)
    for number, latency_ms in enumerate(latencies_ms):
        lip_sync.handle_picture(33 * number * MS, latency_ms * MS)
    least_ns = lip_sync.least_latency_ns(at_ns)
    return None if least_ns is None else least_ns / MS


@pytest.mark.parametrize(
    ("latencies_ms", "least"),
    [
        ([], None),
        # Sound may be 45 ms ahead of pictures; the margin is 3 ms.
        ([120] * 60, 78),
        # Pictures within 40 ms: sound of any latency is in sync.
        ([40] * 60, -2),
        # A single late picture delays no sound, and one too old never does.
        ([60] * 58 + [250, 60], 18),
        ([500] * 60, None),
        # 95 % of the pictures are in time.
        ([60] * 38 + [100] * 3, 58),
        ([60] * 38 + [100] * 2, 18),
        # If most pictures are too late to be useful, the others do not matter. Half is not most.
        ([500, 200, 500] * 20, None),
        ([200, 500, 200] * 20, 153),
        ([60, 500] * 20, None),
        # Sound never becomes too old.
        ([299] * 60, 153),
        ([300] * 60, None),
    ],
)
def test_sound_waits_for_pictures_only_as_long_as_needed(latencies_ms, least):
    assert least_ms(latencies_ms) == least
    assert EARLIEST_NS == 45 * MS  # ITU-R BT.1359-1


def test_the_last_picture_counts_for_2_s():
    for at_ns, least in ((LAST_NS, 78), (LAST_NS + 2000 * MS - 1, 78), (LAST_NS + 2000 * MS, None)):
        assert least_ms([120] * 60, at_ns) == least
