"""What `kontur-av maintain` says and logs beside its steps."""

import json

from pipelines.commands.maintain import OF_SESSION
from pipelines.session.kept_files import Note
from pipelines.upkeep.sequence import MaintenanceSequence, StepOutcome
from pipelines.upkeep.sequence_runner import MaintenanceLog, SequenceRunner


class Watch:
    """A session that announces what it is given, and keeps its notes."""

    name = "lab-1"

    def __init__(self):
        self.said, self.notes, self.runs_now = [], [], ""

    def contact(self):
        return True

    def experiment(self):
        return self.runs_now

    def announcements(self):
        said, self.said = self.said, []
        return said

    def note(self, note):
        self.notes.append(note)


def test_announcements_and_milestones_are_said_and_logged(tmp_path):
    sequence = MaintenanceSequence(["milestone image is up", "say so far"], {"tc"})
    watch, lines = Watch(), []
    with MaintenanceLog(tmp_path / "log") as log:
        runner = SequenceRunner(sequence, log, command=(), say=lines.append, watch=watch)
        watch.said = ["loss of signal in 60 s", "maintain: tc robot ping: done"]
        assert runner.look() == "contact"
        assert runner.run(sequence.next) is StepOutcome.DONE
        assert runner.run(sequence.next) is StepOutcome.DONE
        assert watch.notes == [Note("milestone", "image is up")]
        watch.runs_now = "a page has the handle"
        assert "a page has the handle" in runner.obstacle()
    # What this program noted itself comes back, and is not said again.
    assert lines[0] == "* loss of signal in 60 s"
    assert lines[1].endswith("image is up")
    assert lines[2] == "  so far"
    logged = [json.loads(line) for line in (tmp_path / "log").read_text().splitlines()]
    kinds = [line["what"] for line in logged]
    assert kinds[:5] == ["announced", "announced", "contact", "step", "milestone"]
    assert logged[4]["text"] == "image is up" and logged[4]["at"]


def test_steps_act_on_the_session_of_the_sequence_unless_they_name_another(tmp_path):
    lines = {
        "tc robot ping": "tc robot ping --session lab-1",
        "tc robot ping --session sea-2": "tc robot ping --session sea-2",
        "file put -- -odd": "file put --session lab-1 -- -odd",
        "doctor": "doctor",
    }
    sequence = MaintenanceSequence(lines, {"tc", "file", "doctor"})
    with MaintenanceLog(tmp_path / "log") as log:
        kinds = {"command": (), "say": print, "of_session": OF_SESSION}
        runner = SequenceRunner(sequence, log, watch=Watch(), **kinds)
        for meant in lines.values():
            assert runner.words_of(sequence.next) == meant.split()
            runner.skip(sequence.next)
