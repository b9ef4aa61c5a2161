"""Figures and verdict of a pass with a plan of tasks."""

import copy

import pytest
from partial_report import partial_report

from pipelines.session.setup.setup_file import BUILT_IN
from pipelines.session.task_journal import STEPS
from pipelines.virtual.campaign.campaign_metrics import (
    Crash,
    SessionTask,
    faults,
    pass_metrics,
    run_metrics,
    signal_s,
    task_faults,
    task_names,
    task_numbers,
    usable_window,
)
from telepresence.tasks.plan import PlannedTask, SessionPlan

S = 1_000_000_000


def run(name="aiming", result="finished", seconds=20.0, steps=STEPS):
    numbers = ("path_m", "force_max_n", "force_mean_n", "delay_ms")
    return {
        **dict.fromkeys(numbers, 1.0),
        **dict.fromkeys(("selected_ns", "frames", "frames_lost"), 0),
        **dict.fromkeys(("error_mean", "error_max")),
        "name": name,
        "run": 1,
        "result": result,
        "reason": "",
        "seconds": seconds,
        "steps": [{"at_ns": S, "step": step} for step in steps],
    }


def report(seconds=100.0, windows=((10, 90),), contact=None, **more):
    """The report of a session without media and with a signal in `windows` (s)."""
    contacts = [
        {"acquired_ns": begin * S, "connected_ns": None, "lost_ns": end and round(end * S)}
        for begin, end in windows
    ]
    heard_s = sum((seconds if end is None else end) - begin for begin, end in windows)
    supervision = {
        "counts": {"signals_acquired": len(windows)},
        "contact_ns": heard_s * S,
        "contacts": contacts,
    }
    gateway = {"supervision": supervision, "radio": {"frames_hit": 3, "contact": contact}}
    samples = round(1000 * seconds)
    haptic = {
        "sent": samples,
        "received": 1000 * heard_s,
        "pauses_s": [[1.0, 20.0]],
        "latency_ms": {"p50": 11.0, "p99": 11.5, "p99.9": 12.0, "max": 12.5, "count": 80_000},
    }
    link = {"frames": samples, "frames_lost": samples - 1000 * heard_s}
    return {
        "seconds": seconds,
        "streams": {},
        "haptic": {"up": haptic, "down": dict(haptic)},
        "link": {"uplink": link, "downlink": link},
        "gateways": {"ground": gateway, "space": gateway},
        "skew_ms": {"video_haptic": None},
        "lip_sync": None,
        "failures": [],
    } | more


def of(*runs, seconds=100.0, signal_s=100.0):
    """A pass with a signal from its beginning, for `signal_s`, and these runs."""
    windows = ((0, None if signal_s == seconds else signal_s),)
    contact = {"usable_from_s": 0.0, "usable_to_s": signal_s}
    return partial_report(report(seconds, windows, contact, tasks=list(runs)))


def test_a_task_counts_if_it_is_finished_in_the_order_of_the_steps():
    early = run(result="lost_signal", seconds=None, steps=(*STEPS[:4], STEPS[8]))
    assert task_faults(of(run(), early)) == []
    # The last step may miss the contact.
    assert task_faults(of(run(steps=STEPS[:-1]))) == []
    assert task_faults(of(early)) == ["no task finished"]
    assert task_faults(of()) == ["no task finished"]

    for steps in (
        (*STEPS[:3], STEPS[4], STEPS[3], *STEPS[5:]),
        (*STEPS[:3], STEPS[2], *STEPS[3:]),
        STEPS[:-2],
        (*STEPS[:5], *STEPS[6:]),
    ):
        assert task_faults(of(run(steps=steps))) == ["out of order"]
    told, shown, ended, last = STEPS[:3], STEPS[3], STEPS[9:11], STEPS[11]
    at_start = STEPS[4]
    for steps in ((*told, *ended, shown, last), (*told, shown, *ended, at_start)):
        late = run(result="lost_signal", seconds=None, steps=steps)
        assert task_faults(of(run(), late)) == []
    for steps in (
        (*told, *ended, last, shown),
        (*told, *ended, shown, shown),
        (*ended, *told, shown),
    ):
        wrong = run(result="lost_signal", seconds=None, steps=steps)
        assert task_faults(of(run(), wrong)) == ["out of order"]
    open_one = run(result="open", seconds=None, steps=STEPS[:3])
    assert "left hanging" in task_faults(of(run(), open_one, signal_s=60.0))
    assert "left hanging" not in task_faults(of(run(), open_one, signal_s=80.0))
    assert task_faults(of(run(), open_one)) == []
    plan = SessionPlan(tasks=(PlannedTask(name="aiming"), PlannedTask(name="line")))
    done = of(run(seconds=20.0), run(seconds=23.0), run("line", "timed_out", 60.0, STEPS[:9]))
    assert task_names(plan) == ("tasks_begun", "tasks_finished", "aiming_s", "line_s")
    assert task_numbers(done) == {"tasks_begun": 3, "tasks_finished": 2, "aiming_s": 21.5}
    assert task_names(None) == ()


TASK = SessionTask(setup=BUILT_IN["spacejustin"], seconds=100.0, seed=1)


CONTACT = {"usable_from_s": 30.0, "usable_to_s": 300.0}


def video(**changed):
    known = {"cap_bps": 85_000, "payload_bps_max_1s": 85_000, "payload_bps_max_100ms": 127_500}
    known |= {"rtp_packets": 2400, "rtp_lost": 0, "frames_captured": 3000}
    known |= {"frames_displayed": 2400, "pauses_s": [], "stale_ns": 0, "stale_episodes": 0}
    latency_ms = {"p50": 48.0, "p99": 60.0, "count": 2400, "stages": {}}
    return known | {"latency_ms": latency_ms} | changed


def test_the_usable_window_is_that_of_the_orbit_and_a_pass_that_kept_its_signal_is_usable():
    assert usable_window(partial_report(report()), 0.0) == (0.0, 100.0)
    assert usable_window(partial_report(report(contact=CONTACT)), 0.0) == (30.0, 100.0)
    assert usable_window(partial_report(report(contact=CONTACT)), 50.0) == (0.0, 100.0)
    assert usable_window(partial_report(report(contact=CONTACT)), 250.0) == (0.0, 50.0)
    assert usable_window(partial_report(report(contact=CONTACT)), 400.0) is None
    found = report(windows=((10, 40), (50, None)))
    assert signal_s(partial_report(found), 30.0, 100.0) == pytest.approx(60.0)
    found["gateways"]["space"] = copy.deepcopy(found["gateways"]["space"])
    found["gateways"]["space"]["supervision"]["contacts"].pop()
    assert signal_s(partial_report(found), 30.0, 100.0) == pytest.approx(10.0)
    metrics = pass_metrics(partial_report(report(windows=((10, 20), (29, None)), contact=CONTACT)))
    assert (metrics.predicted_s, metrics.usable_s) == (70.0, 70.0)
    assert faults(metrics) == []
    lost = report(windows=((20, 50), (51, None)), contact=CONTACT)
    assert faults(pass_metrics(partial_report(lost))) == ["unusable"]
    assert faults(Crash("killed")) == ["crashed"]


@pytest.mark.parametrize(
    ("change", "word"),
    [
        (lambda it: it.update(failures=["something"]), "failed"),
        (lambda it: it["haptic"]["up"].update(pauses_s=[[50, 51.1]]), "stuck"),
        (lambda it: it["streams"]["uplink_video"].update(pauses_s=[[25, 33.1]]), "stuck"),
        (lambda it: it["haptic"]["down"]["port"].update(least_uj=-3), "unstable"),
        (lambda it: it["streams"].update(uplink_video=video(payload_bps_max_1s=85_100)), "cap"),
        (lambda it: it["streams"].update(uplink_video=video(payload_bps_max_100ms=128_000)), "cap"),
    ],
)
def test_each_fault_has_its_word(change, word):
    found = report(windows=((20, None),), contact=CONTACT)
    found["streams"]["uplink_video"] = video()
    found["haptic"]["down"]["port"] = {"least_uj": -2}
    assert faults(pass_metrics(partial_report(found))) == []
    change(found)
    named = faults(pass_metrics(partial_report(found)))
    assert len(named) == 1
    assert word in named[0]


def test_a_pause_counts_only_with_a_signal_and_an_empty_stream_has_no_latencies():
    found = report(windows=((20, 50), (50.5, None)), contact=CONTACT)
    # Of these 12, 5 and 3 s no more than 2.9 at a time were with a signal from second 30 on.
    found["streams"]["uplink_video"] = video(pauses_s=[[20, 32.9], [47.5, 52.5], [97.1, 100.0]])
    metrics = pass_metrics(partial_report(found))
    assert metrics.longest_pause_s == {"shown": 2.9, "felt": 0.0}
    assert faults(metrics) == []
    found["gateways"]["ground"]["radio"]["contact"] = CONTACT | {"usable_to_s": 99.0}
    assert pass_metrics(partial_report(found)).longest_pause_s["shown"] == 2.9
    found["streams"]["uplink_video"]["pauses_s"] = [[95.1, 100.0]]
    assert pass_metrics(partial_report(found)).longest_pause_s["shown"] == 3.9
    silent = report(windows=((20, None),), contact=CONTACT)
    none = dict.fromkeys(("p50", "p99", "p99.9", "max"), 0.0) | {"count": 0}
    silent["haptic"]["up"]["latency_ms"] = none
    silent["streams"]["uplink_video"] = video(latency_ms=none)
    found = run_metrics(TASK, "key", partial_report(silent), ())
    assert found.faults == ()
    assert found.metrics["force_p99_ms"] is None
    assert found.metrics["video_p50_ms"] is None
    assert found.metrics["shown_hz"] == 30.0
    assert found.metrics["lost_up_pct"] == 20.0
