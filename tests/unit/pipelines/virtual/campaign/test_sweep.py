"""A sweep's table: medians over seeds, verdicts, and runs that are missing."""

from pipelines.session.setup.setup_file import BUILT_IN
from pipelines.virtual.campaign import sweep
from pipelines.virtual.campaign.campaign_metrics import RunMetrics

SWEEP = sweep.Sweep(
    name="mine",
    seconds=5.0,
    seeds=(1, 2, 3),
    media=False,
    cases=(
        sweep.Case({"radio": "cable"}, BUILT_IN["taskboard"]),
        sweep.Case({"radio_delay_ms": 5}, BUILT_IN["spacejustin"]),
    ),
    fields=("radio", "radio_delay_ms"),
    keys=("a.b",),
    x=None,
    y="force_p99_ms",
)


def run_of(seed, **metrics):
    return RunMetrics(key="", seed=seed, metrics=metrics)


def test_a_case_has_median_least_and_largest_of_its_seeds():
    stuck = RunMetrics(key="", seed=3, faults=("stuck",), metrics={"force_p99_ms": 9.0})
    runs = [run_of(1, force_p99_ms=2.0), run_of(2, force_p99_ms=3.0), stuck, None, None, None]
    first, second = sweep.case_metrics(SWEEP, runs)
    assert first.metrics["force_p99_ms"] == sweep.SeedSpread(median=3.0, least=2.0, largest=9.0)
    assert (first.runs, first.usable, first.faults) == (3, 2, {"stuck": 1})
    assert second.metrics["force_p99_ms"] is None
    assert sweep.headings(SWEEP, [first, second]) == [*SWEEP.fields, "force p99 ms", "verdict"]
    assert list(sweep.rows(SWEEP, [first, second])) == [
        ["cable", "", "3 (2 to 9)", "2 of 3 usable, 1 stuck"],
        ["", "5", "", "not run"],
    ]
    heading, *of_runs = sweep.csv_rows(SWEEP, runs)
    assert [row[:3] for row in of_runs] == [["cable", "", seed] for seed in (1, 2, 3)]
    assert of_runs[2][heading.index("force_p99_ms")] == 9.0


def test_a_run_is_known_by_all_that_decides_its_metrics():
    tasks = SWEEP.tasks()
    keys = {sweep.task_key(task, (), "code") for task in tasks}
    assert len(keys) == 6
    assert sweep.task_key(tasks[0], (), "code") in keys
    assert sweep.task_key(tasks[0], (), "other") not in keys
    assert sweep.task_key(tasks[0], ("a.b",), "code") not in keys
