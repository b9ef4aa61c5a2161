"""`python -m benchmarks all`: its plan, its records, its page, and resuming a measurement."""

from dataclasses import replace

import pytest
from bench_records import MACHINE, RECORD
from positions import ROOT

from benchmarks import BENCHMARKS
from benchmarks.__main__ import main, make_parser
from benchmarks.all.page import page
from benchmarks.all.plan import LENGTHS, LIVE_RUNS, in_turn, measurements
from benchmarks.all.records import read_record, read_records, write_record
from benchmarks.all.run import words_of
from kontur_av.errors import ConfigError
from pipelines.bench import BENCHES
from pipelines.cli import make_parser as make_command_parser
from pipelines.report.result import Headline

#: Sweeps take long.
LEFT_OUT = {"quick": {"passes"}, "full": set(), "smoke": {"passes", "tasks"}}


def with_value(number, value, met):
    first = replace(RECORD.headlines[0], value=value, met=met)
    return replace(RECORD, number=number, headlines=(first, *RECORD.headlines[1:]))


@pytest.mark.parametrize("length", LENGTHS)
def test_every_bench_is_in_the_plan_and_every_command_is_one(length):
    plan = measurements(length)
    names = {one.name for one in plan}
    assert {"passes", "tasks"} - names == LEFT_OUT[length]
    benches = {words[1] for one in plan if (words := words_of(one.command)[2:])[0] == "bench"}
    assert benches == set(BENCHES) - {"video", "path"}
    assert set(BENCHMARKS) - {"all"} <= names
    of_benchmarks, of_commands = make_parser(), make_command_parser()
    for one in plan:
        _, module, *words = words_of(one.command)
        parser = of_commands if module == "pipelines.cli" else of_benchmarks
        parser.parse_args(words)
        assert words[0] != "sweep" or (ROOT / words[1]).is_file()


def test_live_benches_run_at_least_three_times_and_a_record_is_read_as_it_was_written(tmp_path):
    virtual = ("haptics", "sync", "passes", "tasks")
    runs = {measurement.name: measurement.runs for measurement in measurements("quick")}
    assert runs == {name: 1 if name in virtual else LIVE_RUNS for name in runs}
    assert LIVE_RUNS >= 3
    plan = measurements("quick", "latency,haptics,cpu")
    order = [f"{one.name} {number}" for one, number in in_turn(plan)]
    assert order[:4] == ["latency 1", "cpu 1", "haptics 1", "latency 2"]
    assert order[4:] == ["cpu 2", "latency 3", "cpu 3"]
    write_record(tmp_path, RECORD)
    assert read_record(tmp_path / "latency-1.json") == RECORD
    assert read_records(tmp_path, ["cpu", "latency"]) == [RECORD]
    (tmp_path / "latency-2.json").write_text('{"name": "latency"}')
    with pytest.raises(ConfigError, match=r"latency-2\.json: no record of `benchmarks all`"):
        read_records(tmp_path, ["latency"])


def test_the_page_shows_median_spread_command_machines_groups_and_failures():
    runs = [with_value(1, 40.0, True), with_value(2, 50.25, False), with_value(3, 42.0, True)]
    text = page(runs, folder="measurements")
    assert f"Machine: {MACHINE}." in text
    assert "Some CPU, 2 cores, Linux 6, Python 3.11.7, PyAV 18.1.0" in text
    assert "```sh\nkontur-av bench latency --seconds 10\n```" in text
    assert "3 runs, 2026-03-04, code 0123456789ab." in text
    assert "| figure | live | virtual | target (live) |" in text
    row = "| picture, p99, ms | 42.0 (40.0…50.2) | 39.5 | <= 45 ms: **missed** in 1 of 3 runs |"
    assert row in text
    headlines = (
        Headline(group="a|b", what="one", unit="", value=3.0),
        Headline(group="other", what="two", unit="µs", value=None),
    )
    failed = replace(RECORD, headlines=headlines, failure="a claim does not hold")
    other = replace(failed, number=2, machine=replace(MACHINE, cpu="Other CPU"), failure="")
    text = page([failed, other], folder="x")
    assert "a\\|b:\n\n- one: 3\n" in text
    assert "- two, µs: –\n" in text
    assert "**Run 1 failed: a claim does not hold**" in text
    assert "Other CPU" in text


#: Options that cannot be, and what the refusal names.
REFUSED = [
    ("all --only nothing", "--only nothing"),
    ("all --quick --full", "--full"),
    ("all --write /nowhere/at/all.md", "--write"),
    ("all --out /proc/nowhere", "--out"),
    ("haptics --cell delay=5000", "delay"),
    ("haptics --random 0", "--random"),
    ("haptics --jobs 0", "--jobs"),
    ("haptics --traces /no/such/place", "/no/such/place"),
    ("haptics --controller no.such:Controller", "no.such"),
    ("video --lead-s -1", "--lead-s -1"),
    ("video --only nobody", "--only nobody"),
    (f"video --crops {__file__}/crops", "--crops"),
    ("voice --jitter-ms 21", "--jitter-ms"),
    ("voice --delay-ms -1", "--delay-ms"),
]


@pytest.mark.parametrize(("words", "named"), REFUSED, ids=[words for words, _ in REFUSED])
def test_mistakes_are_one_line(words, named, capsys):
    assert main(words.split()) == 2
    error = capsys.readouterr().err
    assert named in error
    assert error.count("\n") == 1
