"""`kontur-av bench all`: its plan, what it keeps, the page, and going on where it ended."""

import sys
from dataclasses import replace
from types import SimpleNamespace

import pytest

from kontur_av.errors import ConfigError
from pipelines.bench import BENCHES
from pipelines.bench.all import command, run
from pipelines.bench.all.page import page
from pipelines.bench.all.plan import LENGTHS, LIVE_RUNS, in_turn, measurements
from pipelines.bench.all.records import Record, read_record, read_records, write_record
from pipelines.bench.machine import Machine, code_digest, this_machine
from pipelines.bench.result import Headline
from pipelines.cli import _parser, main

MACHINE = Machine(cpu="Some CPU", cores=2, kernel="Linux 6", python="3.11.7", pyav="18.1.0")
RECORD = Record(
    name="latency",
    title="Latency",
    command="kontur-av bench latency --seconds 10",
    number=1,
    date="2026-03-04T05:06:07+00:00",
    code="0123456789ab",
    machine=MACHINE,
    failure="",
    headlines=(
        Headline(
            what="picture, p99", who="live", unit="ms", value=40.0, target="<= 45 ms", met=True
        ),
        Headline(what="picture, p99", who="virtual", unit="ms", value=39.5),
    ),
)


def with_value(number, value, met):
    first = replace(RECORD.headlines[0], value=value, met=met)
    return replace(RECORD, number=number, headlines=(first, *RECORD.headlines[1:]))


@pytest.mark.parametrize("length", LENGTHS)
def test_every_bench_is_in_the_plan_and_every_command_is_one(length):
    plan = measurements(length)
    assert {one.words[0] for one in plan} == set(BENCHES) - {"all"}
    for one in plan:
        _parser("bench").parse_args(one.command.split()[1:])


def test_what_is_live_runs_at_least_three_times():
    for one in measurements("quick"):
        virtual = one.name in ("haptics", "sync", "passes")
        assert one.runs == (1 if virtual else LIVE_RUNS)
    assert LIVE_RUNS >= 3


def test_runs_of_two_benches_take_turns():
    plan = measurements("quick", "latency,haptics,cpu")
    order = [(one.name, number) for one, number in in_turn(plan)]
    assert order[:4] == [("latency", 1), ("cpu", 1), ("haptics", 1), ("latency", 2)]
    assert order[4:] == [("cpu", 2), ("latency", 3), ("cpu", 3)]


def test_a_record_is_read_as_it_was_written(tmp_path):
    write_record(tmp_path, RECORD)
    assert read_record(tmp_path / "latency-1.json") == RECORD
    assert read_records(tmp_path, ["cpu", "latency"]) == [RECORD]
    (tmp_path / "latency-2.json").write_text('{"name": "latency"}')
    with pytest.raises(ConfigError, match=r"latency-2\.json: no record of `bench all`"):
        read_records(tmp_path, ["latency"])


def test_the_page_shows_median_spread_command_machine_and_a_miss():
    runs = [with_value(1, 40.0, True), with_value(2, 50.25, False), with_value(3, 42.0, True)]
    text = page(runs, folder="measurements")
    assert f"Machine: {MACHINE}." in text
    assert "Some CPU, 2 cores, Linux 6, Python 3.11.7, PyAV 18.1.0" in text
    assert "```sh\nkontur-av bench latency --seconds 10\n```" in text
    assert "3 runs, 2026-03-04, code 0123456789ab." in text
    assert "| figure | unit | live | virtual | target (live) |" in text
    row = "| picture, p99 | ms | 42.0 (40.0 to 50.2) | 39.5 | <= 45 ms: **missed** in 1 of 3 runs |"
    assert row in text


def test_each_group_has_a_table_and_what_was_not_measured_has_a_dash():
    headlines = (
        Headline(group="a|b", what="one", unit="", value=3.0),
        Headline(group="other", what="two", unit="µs", value=None),
    )
    text = page([replace(RECORD, headlines=headlines)], folder="x")
    assert "| a\\|b | unit | median (least to largest) |\n|---|---|--:|\n| one |  | 3 |" in text
    assert "| two | µs | – |" in text


def test_a_failed_run_and_another_machine_are_on_the_page():
    failed = replace(RECORD, failure="a claim does not hold")
    other = replace(RECORD, number=2, machine=replace(MACHINE, cpu="Other CPU"))
    text = page([failed, other], folder="x")
    assert "**Run 1 failed: a claim does not hold**" in text
    assert "Other CPU" in text


@pytest.fixture
def bench(tmp_path, monkeypatch):
    """A stand-in for a bench: it counts its runs and writes one headline."""
    script = tmp_path / "bench.py"
    counter = tmp_path / "runs"
    script.write_text(
        "import json, sys\n"
        f"open({str(counter)!r}, 'a').write('.')\n"
        "headline = dict(group='', what='x', who='', unit='ms', value=1.5, target='', met=None)\n"
        "json.dump({'headlines': [headline]}, open(sys.argv[-1], 'w'))\n"
        "print('the last words')\n"
        "sys.exit('passes' in sys.argv)\n"
    )
    shell = tmp_path / "python"
    shell.write_text(f'#!/bin/sh\nexec {sys.executable} {script} "$@"\n')
    shell.chmod(0o755)
    monkeypatch.setattr(run, "sys", SimpleNamespace(executable=str(shell)))
    return lambda: len(counter.read_text()) if counter.exists() else 0


def test_runs_that_are_there_are_kept_and_others_are_made(bench, tmp_path, capsys, monkeypatch):
    write = tmp_path / "page.md"
    words = ["bench", "all", "--only", "cpu,haptics", "--write", str(write)]
    assert main(words) == 0
    assert bench() == LIVE_RUNS + 1
    assert sorted(path.name for path in (tmp_path / "page").iterdir()) == [
        *(f"cpu-{number}.json" for number in (1, 2, 3)),
        "haptics-1.json",
    ]
    assert "| x | ms | 1.50 |" in write.read_text()
    (tmp_path / "page" / "cpu-2.json").unlink()
    assert main(words) == 0
    assert bench() == LIVE_RUNS + 2
    assert "cpu, run 1 of 3: kept" in capsys.readouterr().out
    monkeypatch.setattr(command, "code_digest", lambda: "other code")
    assert main(words) == 0
    assert bench() == 2 * LIVE_RUNS + 3
    assert main([*words, "--again"]) == 0
    assert bench() == 3 * LIVE_RUNS + 4


def test_a_bench_that_fails_is_an_exit_code_and_on_the_page(bench, tmp_path):
    write = tmp_path / "page.md"
    assert main(["bench", "all", "--only", "passes", "--write", str(write)]) == 1
    assert "**Run 1 failed: the last words**" in write.read_text()


def test_the_page_is_rendered_without_measuring(bench, tmp_path, capsys):
    write_record(tmp_path, RECORD)
    assert main(["bench", "all", "--render", "--out", str(tmp_path)]) == 0
    assert "# Measurements" in capsys.readouterr().out
    assert main(["bench", "all", "--render", "--out", str(tmp_path / "nowhere")]) == 2
    assert bench() == 0


def test_an_interrupted_measurement_still_writes_its_page(bench, tmp_path, monkeypatch):
    measure = run.measure

    def interrupted(measurement, number, code):
        if number == 2:
            raise KeyboardInterrupt
        return measure(measurement, number, code)

    monkeypatch.setattr(command, "measure", interrupted)
    write = tmp_path / "page.md"
    assert main(["bench", "all", "--only", "cpu", "--write", str(write)]) == 130
    assert "1 run," in write.read_text()


@pytest.mark.parametrize(
    ("options", "told"),
    [
        (["--only", "nothing"], "--only nothing"),
        (["--quick", "--full"], "--full"),
        (["--write", "/nowhere/at/all.md"], "--write"),
        (["--out", "/proc/nowhere"], "--out"),
    ],
)
def test_mistakes_are_one_line(options, told, capsys):
    assert main(["bench", "all", *options]) == 2
    error = capsys.readouterr().err
    assert told in error
    assert error.count("\n") == 1


def test_machine_and_code_are_named():
    machine = this_machine()
    assert machine.cores >= 1
    assert machine.kernel.startswith("Linux")
    assert len(code_digest()) == 12
