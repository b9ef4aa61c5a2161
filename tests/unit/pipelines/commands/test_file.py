"""`kontur-av file`: how it follows a transfer."""

from unittest.mock import Mock

import pytest

from pipelines.cli import main
from pipelines.commands import file
from pipelines.session.transfer_requests import FileAnswer

UNDER_WAY = FileAnswer(number=7, state="sending", octets=5, size=5)
SLOW = TimeoutError()
DONE = FileAnswer(number=7, state=file.DONE, octets=5, size=5)


class Time:
    """Each look at the clock takes 2 s."""

    now_s = 0.0

    def monotonic(self):
        self.now_s += 2.0
        return self.now_s

    def sleep(self, seconds):
        self.now_s += seconds


@pytest.mark.parametrize(
    ("answers", "code", "says"),
    [
        # SLOW stands for a question without an answer: a pause of the session is outlived.
        ([UNDER_WAY, *[SLOW] * 8, UNDER_WAY, *[SLOW] * 8, DONE], 0, ""),
        ([SLOW], 1, "the session has not answered"),
        ([UNDER_WAY, *[SLOW] * 20], 1, "the session has not answered"),
    ],
)
def test_a_session_that_stays_silent_is_a_failure_and_a_pause_is_none(
    monkeypatch, capsys, answers, code, says
):
    ask = Mock(side_effect=answers)
    monkeypatch.setattr(file, "time", Time())
    monkeypatch.setattr(file, "running_sessions", lambda _service: ["s"])
    monkeypatch.setattr(file, "acting_on", lambda *_, **_named: "s")
    monkeypatch.setattr(file, "ask", ask)
    assert main(["file", "put", "a.txt"]) == code
    assert says in capsys.readouterr().err
