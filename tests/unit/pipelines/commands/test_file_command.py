"""`kontur-av file`: how it follows a transfer."""

import pytest

from pipelines.cli import main
from pipelines.commands import file
from pipelines.session.terminal_lines import FileAnswer

UNDER_WAY = FileAnswer(ok=True, number=7, state="sending", octets=5, size=5)
DONE = FileAnswer(ok=True, number=7, state=file.DONE, octets=5, size=5)


class Time:
    """Each look at the clock takes 2 s."""

    now_s = 0.0

    def monotonic(self):
        self.now_s += 2.0
        return self.now_s

    def sleep(self, seconds):
        self.now_s += seconds


@pytest.fixture
def answering(monkeypatch):
    """Let a session give these answers, one after the other."""

    def answer(*answers):
        given = iter(answers)
        monkeypatch.setattr(file, "time", Time())
        monkeypatch.setattr(file, "running_sessions", lambda _desk: ["s"])
        monkeypatch.setattr(file, "acting_on", lambda *_: "s")
        monkeypatch.setattr(file, "ask_desk", lambda *_, **__: next(given))

    return answer


def test_a_transfer_under_way_outlives_a_pause_of_the_session(answering):
    # None stands for a question without an answer.
    answering(UNDER_WAY, *[None] * 8, UNDER_WAY, *[None] * 8, DONE)
    assert main(["file", "put", "a.txt"]) == 0


@pytest.mark.parametrize("answers", [[None], [UNDER_WAY, *[None] * 20]])
def test_a_session_that_stays_silent_is_a_failure(answering, answers, capsys):
    answering(*answers)
    assert main(["file", "put", "a.txt"]) == 1
    assert "the session has not answered" in capsys.readouterr().err
