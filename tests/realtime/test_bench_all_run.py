"""`python -m benchmarks all`: runs, kept records, and resuming a measurement."""

import sys
from types import SimpleNamespace

import pytest
from bench_records import RECORD

from benchmarks.__main__ import main
from benchmarks.all import command, run
from benchmarks.all.plan import LIVE_RUNS
from benchmarks.all.records import write_record


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
        "sys.exit('sweep' in sys.argv)\n"
    )
    shell = tmp_path / "python"
    shell.write_text(f'#!/bin/sh\nexec {sys.executable} {script} "$@"\n')
    shell.chmod(0o755)
    monkeypatch.setattr(run, "sys", SimpleNamespace(executable=str(shell)))
    return lambda: len(counter.read_text()) if counter.exists() else 0


def test_existing_runs_are_kept_and_missing_ones_are_made(bench, tmp_path, capsys, monkeypatch):
    write = tmp_path / "page.md"
    words = ["all", "--only", "cpu,haptics", "--write", str(write)]
    assert main(words) == 0
    assert bench() == LIVE_RUNS + 1
    assert sorted(path.name for path in (tmp_path / "page").iterdir()) == [
        *(f"cpu-{number}.json" for number in (1, 2, 3)),
        "haptics-1.json",
    ]
    assert "\n- x, ms: 1.50\n" in write.read_text()
    (tmp_path / "page" / "cpu-2.json").unlink()
    assert main(words) == 0
    assert bench() == LIVE_RUNS + 2
    assert "cpu, run 1 of 3: kept" in capsys.readouterr().out
    monkeypatch.setattr(command, "code_digest", lambda packages: "other code")
    assert main(words) == 0
    assert bench() == 2 * LIVE_RUNS + 3
    assert main([*words, "--again"]) == 0
    assert bench() == 3 * LIVE_RUNS + 4
    # Without measuring.
    write_record(tmp_path, RECORD)
    assert main(["all", "--render", "--out", str(tmp_path)]) == 0
    assert "# Measurements" in capsys.readouterr().out
    assert main(["all", "--render", "--out", str(tmp_path / "nowhere")]) == 2
    assert bench() == 3 * LIVE_RUNS + 4


def test_a_bench_that_fails_is_an_exit_code_and_on_the_page(bench, tmp_path):
    write = tmp_path / "page.md"
    assert main(["all", "--only", "tasks", "--write", str(write)]) == 1
    assert "**Run 1 failed: the last words**" in write.read_text()


def test_an_interrupted_measurement_still_writes_its_page(bench, tmp_path, monkeypatch):
    measure = run.measure

    def interrupted(measurement, number, code):
        if number == 2:
            raise KeyboardInterrupt
        return measure(measurement, number, code)

    monkeypatch.setattr(command, "measure", interrupted)
    write = tmp_path / "page.md"
    assert main(["all", "--only", "cpu", "--write", str(write)]) == 130
    assert "1 run," in write.read_text()
