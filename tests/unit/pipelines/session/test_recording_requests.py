"""A recording that a terminal holds: how it ends."""

import pytest

from pipelines.session import recording_requests
from pipelines.session.recording_requests import (
    AskRecording,
    RecordAnswer,
    RecordingOptions,
    StopRecording,
    hold_recording,
)

OPTIONS = RecordingOptions(file="/tmp/a.mcap", held=True)
#: A new part has another name.
GOES_ON = [RecordAnswer(file=f"/tmp/a{part}.mcap") for part in ("", "-2")]
WHOLE = RecordAnswer(messages=7)


class Recorder:
    def __init__(self, *answers):
        self.answers, self.asked, self.closed = list(answers), [], False

    def ask(self, request, _kind):
        self.asked.append(type(request))
        return self.answers.pop(0)

    def close(self):
        self.closed = True


@pytest.mark.parametrize(
    ("stops", "asked"),
    [(True, [*[AskRecording] * 2, StopRecording]), (False, [AskRecording] * 3)],
    ids=["by its terminal", "by somebody else"],
)
def test_it_ends_with_what_was_recorded(monkeypatch, stops, asked):
    monkeypatch.setattr(recording_requests, "_LOOK_S", 0.0)
    recorder = Recorder(*GOES_ON, WHOLE)
    ended = lambda: stops and len(recorder.asked) == 1  # noqa: E731
    assert hold_recording(recorder, "s", OPTIONS, ended, None) == WHOLE
    assert recorder.asked == asked and recorder.closed
