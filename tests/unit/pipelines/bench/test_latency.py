"""`kontur-av bench latency`: targets, terms, chart and mistakes."""

from partial_report import partial_report

from pipelines.bench.latency import judge


def spread(**changed):
    return {"p50": 10, "p95": 10, "p99": 10, "p99.9": 10, "max": 10, "count": 9, **changed}


def report(force=13.0, video=45.0, voice=60.0, skew=45.0, within=1.0, delay_ns=10_000_000):
    return {
        "haptic": {"up": {"latency_ms": spread(**{"p99.9": force})}},
        "gateways": {"ground": {"radio": {"delay_max_ns": delay_ns}}},
        "streams": {
            "uplink_video": {"latency_ms": spread(p99=video)},
            "uplink_voice": {"latency_ms": spread(p99=voice)},
        },
        "skew_ms": {"video_haptic": {"p50": 0, "p95": skew, "p99": skew, "max": 99, "count": 9}},
        "lip_sync": {"within": within, "early": 0, "late": 0},
    }


def test_all_targets_are_met_at_their_bounds_and_a_little_more_misses_one():
    verdicts = judge(partial_report(report()))
    assert len(verdicts) == 5
    assert all(verdict.met for verdict in verdicts)

    for change in (
        *({"force": 13.01}, {"delay_ns": 9_990_000}, {"video": 45.01}, {"voice": 60.01}),
        *({"skew": 45.01}, {"within": 0.999_999}),
    ):
        met = [verdict.met for verdict in judge(partial_report(report(**change)))]
        assert met.count(False) == 1, change
    found = report()
    del found["streams"]["uplink_voice"]
    found["lip_sync"] = None
    found["skew_ms"]["video_haptic"] = None
    judged = [verdict.what.split(",")[0] for verdict in judge(partial_report(found))]
    assert judged == ["force", "uplink_video"]
