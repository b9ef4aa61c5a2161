"""Each run of a task has its own recording, whatever was recorded before."""

from types import SimpleNamespace

import pytest

from kontur_av.errors import ConfigError
from pipelines.mission import process_tasks
from pipelines.mission.process_tasks import RunFiles
from pipelines.session.recording_requests import StartRecording, StopRecording


class Recorder:
    """What a session's recorder answers."""

    def __init__(self, file=""):
        self.file, self.files = file, []

    def ask(self, _session, _service, request, kind, **_):
        if isinstance(request, StartRecording):
            if self.file:
                raise ConfigError(f"recorded already, to {self.file}")
            self.file = request.options.file
            self.files.append(self.file)
        elif isinstance(request, StopRecording):
            self.file = ""
        return kind(file=self.file)


class AtOnce:
    """In the place of the queue to the thread: what is put into it is done."""

    def put(self, work):
        if work is not None:
            work()

    def get(self):
        """The thread ends."""


@pytest.fixture
def recorder(monkeypatch):
    found = Recorder()
    monkeypatch.setattr(process_tasks, "ask", found.ask)
    monkeypatch.setattr(process_tasks, "queue", SimpleNamespace(Queue=AtOnce))
    no_time = SimpleNamespace(sleep=lambda _: None)
    monkeypatch.setattr(process_tasks, "time", no_time)
    return found


def do(*runs):
    files = RunFiles("s", "/runs")
    for run in runs:
        for on in (True, False):
            files.record(on=on, task="line", run=run)
            assert files.recording is on
    files.close()
    return files


def test_each_run_has_a_file_also_after_one_that_an_earlier_life_left_open(recorder):
    recorder.file = "/runs/run-001-line.mcap"
    files = do(2, 3)
    assert recorder.files == ["/runs/run-002-line.mcap", "/runs/run-003-line.mcap"]
    assert recorder.file == "" and files.unrecorded == 0


def test_the_recording_of_somebody_else_goes_on_and_is_named(recorder):
    recorder.file = "/home/me/all.mcap"
    files = do(1)
    assert recorder.file == "/home/me/all.mcap"
    assert (files.unrecorded, files.why) == (1, "recorded already, to /home/me/all.mcap")
