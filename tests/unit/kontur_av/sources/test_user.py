"""A user's camera and microphone: nonsense is a fault, and ends nothing."""

import numpy as np
import pytest

from kontur_av.clock import NS_PER_S, ManualClock
from kontur_av.media import AudioFrame, CaptureStamp, Tip, empty_picture
from kontur_av.sources.source import RETRY_NS
from kontur_av.sources.user import UserSource

NOW_NS = 5 * NS_PER_S
SOUND = np.zeros(960, np.int16)


def stamp(capture_ns=NOW_NS, sequence=3):
    return CaptureStamp(capture_ns, sequence, "x" * 99)


class Source:
    """What a user wrote: it returns `found`, or raises it."""

    def __init__(self, found, faults=0, last_fault=""):
        self.found, self.faults, self.last_fault = found, faults, last_fault

    def read(self, *_):
        if isinstance(self.found, Exception):
            raise self.found
        return self.found

    def close(self):
        raise OSError("E2: stuck")


def read(found, **counters):
    """What comes of a source that returns `found`, and the source."""
    gives = AudioFrame if isinstance(found, AudioFrame) else CaptureStamp
    clock = ManualClock(NOW_NS)
    source = UserSource(Source(found, **counters), gives, "left", clock, "own:Camera")
    into = () if gives is AudioFrame else (empty_picture(64, 48),)
    return source.read(*into, NS_PER_S), source


@pytest.mark.parametrize(
    "found", [stamp(), stamp(np.int64(NOW_NS)), stamp(np.array([NOW_NS])), stamp(float(NOW_NS))]
)
def test_stamps_are_made_anew_of_any_whole_number(found):
    taken, source = read(found)
    assert taken == CaptureStamp(NOW_NS, 0, "left") and type(taken.capture_ns) is int
    assert source.faults == 0
    sound, _ = read(AudioFrame(SOUND.reshape(960, 1), found))
    assert sound.samples.shape == (960,) and sound.stamp == taken
    assert read(None)[0] is None


@pytest.mark.parametrize(
    ("found", "said"),
    [
        (OSError("E17: lens cap"), "read() failed: OSError: E17: lens cap"),
        (7, "read() returned a int: give CaptureStamp"),
        (stamp(float("nan")), "capture_ns = nan: give a whole number"),
        (stamp(1 << 70), "give clock.now_ns()"),
        (stamp(-1), "give clock.now_ns()"),
        (AudioFrame(SOUND[:900], stamp()), "900 samples of int16: give 960 of int16"),
        (AudioFrame(SOUND.astype(float), stamp()), "960 samples of float64: give 960 of int16"),
        (AudioFrame("sound", stamp()), "1 samples of <U5: give 960 of int16"),
        (AudioFrame(SOUND, None), "read() failed: AttributeError: 'NoneType'"),
    ],
)
def test_nonsense_is_a_fault_with_the_name_of_the_source_and_the_mend(found, said):
    taken, source = read(found)
    assert taken is None and source.faults == 1
    assert source.last_fault.startswith("own:Camera: ") and said in source.last_fault
    # It does not fail as fast as it can.
    assert source._clock.now_ns() == NOW_NS + RETRY_NS
    source.close()
    assert "E2: stuck" in source.last_fault


def test_its_own_faults_are_told():
    _, source = read(stamp())
    source._source.tip = lambda: (np.float32(0.5), 1)
    assert source.tip() == Tip(0.5, 1.0)
    _, source = read(stamp(), faults=np.int32(2), last_fault="E17\nlens cap")
    assert (source.faults, source.last_fault) == (1, "own:Camera: E17 lens cap")
    assert "faults = None" in read(stamp(), faults=None)[1].last_fault
