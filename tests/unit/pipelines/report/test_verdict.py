"""Whether each process of a session did its work."""

import pytest

from kontur_av.clock import NS_PER_S
from pipelines.report.verdict import ProcessNow, process_failures
from pipelines.session.session_switch import NO_REASON


def failures(**facts):
    known = {"name": "robot", "restarts": 0, "running": True, "error": ""}
    return process_failures([ProcessNow(**known | facts)])


def s(seconds):
    return round(seconds * NS_PER_S)


@pytest.mark.parametrize(
    ("facts", "said"),
    [
        ({"silent_ns": s(3)}, "it hangs: no cycle ended for 3 s"),
        ({"silent_ns": s(15), "idle": True}, "it hangs: no cycle ended for 15 s"),
        ({"silent_ns": s(15), "told": False}, "it has not come up in 15 s"),
        ({"restarts": 3, "error": "ended by SIGKILL"}, "3 times: ended by SIGKILL"),
        ({"restarts": 1, "error": NO_REASON}, "it ended without a reason"),
        ({"running": False, "error": NO_REASON}, "it ended without a reason"),
    ],
)
def test_one_that_did_not_do_its_work_is_named_with_its_reason(facts, said):
    (line,) = failures(**facts)
    assert line.startswith("robot: ") and said in line
    # One that is not to run owes nothing.
    assert failures(**facts, wanted=False) == []


@pytest.mark.parametrize(
    "facts",
    [
        {"silent_ns": s(2.9)},
        {"silent_ns": s(14), "idle": True},
        {"silent_ns": s(14), "told": False},
        {"restarts": 2, "error": "ended by SIGKILL"},
        {"running": False, "silent_ns": s(60), "error": "ended by SIGSEGV"},
    ],
)
def test_one_that_is_a_little_late_or_was_killed_twice_has_not_failed(facts):
    assert failures(**facts) == []
