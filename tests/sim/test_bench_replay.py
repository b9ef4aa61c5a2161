"""`kontur-av bench replay`: the same link gives the same pictures, and others what they lose."""

import json

import msgspec
import pytest
from synthetic_recording import write_recording

from benchmarks.replay.figures import SAME, Case, ReplayResult, headlines
from pipelines.cli import main
from pipelines.report.model import SessionReport, from_json


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    """Exit code and report of the bench on a small recording."""
    folder = tmp_path_factory.mktemp("bench")
    (path,) = write_recording(folder / "a.mcap", seconds=3.0).paths
    report = folder / "report.json"
    words = ["bench", "replay", "--recording", str(path), "--seconds", "3", "--loss", "2"]
    code = main([*words, "--report", str(report)])
    return code, json.loads(report.read_text())


def by_case(bench, what):
    _, report = bench
    return {one["who"]: one["value"] for one in report["headlines"] if one["what"] == what}


def test_the_link_of_the_recording_gives_its_pictures_and_others_do_not(bench):
    code, report = bench
    assert code == 0
    judged = [one for one in report["headlines"] if one["met"] is not None]
    assert len(judged) == 4 and all(one["met"] and one["who"] == SAME for one in judged)
    cases = [SAME, "geo", "geo, coded anew", "2 % loss", "2 % loss, coded anew"]
    whole = by_case(bench, "uplink_video, access units that came whole")
    assert list(whole) == cases
    assert whole[SAME] == 100 and whole["2 % loss"] < 95
    assert whole["2 % loss, coded anew"] is None
    late = by_case(bench, "force, one way, p50")
    assert late["geo"] > 300 > late[SAME]
    lost = by_case(bench, "motion, samples lost")
    assert lost[SAME] == 0 and 1 < lost["2 % loss"] < 3


@pytest.mark.parametrize("field", ["same_received", "pictures_same"])
def test_a_picture_that_does_not_come_again_is_a_failure(bench, field):
    _, report = bench
    first = from_json(json.dumps(report["cases"][0]["report"]), SessionReport)
    stream = first.replay.streams["uplink_video"]
    fewer = msgspec.structs.replace(stream, **{field: getattr(stream, field) - 1})
    replay = msgspec.structs.replace(
        first.replay, streams={**first.replay.streams, "uplink_video": fewer}
    )
    for one, sound in ((first, True), (msgspec.structs.replace(first, replay=replay), False)):
        cases = (Case(name=SAME, report=one),)
        result = ReplayResult(setup="spacejustin", seconds=3, cases=cases)
        assert result.sound is sound
        assert all(each.met is not False for each in headlines(result)) is sound
