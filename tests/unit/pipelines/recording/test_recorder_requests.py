"""Which requests to record and to stop a recorder carries out."""

import pytest

from kontur_av.clock import NS_PER_S
from kontur_av.errors import ConfigError
from pipelines.recording.recorder_requests import HOLD_NS, RecorderRequests
from pipelines.session.recording_requests import RecordingOptions, StartRecording

FREE = RecordingOptions(file="/tmp/a.mcap")
HELD = RecordingOptions(file="/tmp/a.mcap", held=True)


def start(requests, options, terminal=1):
    """Whether a recording begins."""
    begins = requests.handle_start(StartRecording(options=options), terminal)
    if begins:
        requests.handle_started(options, terminal)
    return begins


def test_a_recording_is_started_and_stopped_once():
    requests = RecorderRequests(None, 0)
    with pytest.raises(ConfigError, match="not being recorded"):
        requests.handle_stop()
    assert start(requests, FREE) and requests.options == FREE
    for other in (FREE, RecordingOptions(file="/tmp/b.mcap"), HELD):
        with pytest.raises(ConfigError, match=r"recorded already, to /tmp/a\.mcap"):
            start(requests, other)
    assert not requests.poll_abandoned(1000 * NS_PER_S)
    requests.handle_stop()
    assert requests.options is None


def test_a_held_recording_ends_some_time_after_its_terminal_which_may_come_back():
    requests = RecorderRequests(None, 0)
    assert start(requests, HELD)
    left_ns = 100 * NS_PER_S
    assert not requests.poll_abandoned(left_ns)
    requests.handle_closed(1, left_ns)
    assert not requests.poll_abandoned(left_ns + HOLD_NS - 1)
    assert requests.poll_abandoned(left_ns + HOLD_NS)
    requests.handle_stop()
    assert not requests.poll_abandoned(left_ns + 3 * HOLD_NS)
    # After the recorder was killed.
    requests = RecorderRequests(HELD, 0)
    assert not start(requests, HELD, 5)
    assert not requests.poll_abandoned(1000 * NS_PER_S) and requests.options == HELD
