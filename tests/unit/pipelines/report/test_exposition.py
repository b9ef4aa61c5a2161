from prometheus_client.parser import text_string_to_metric_families

from pipelines.report.exposition import Exposition

REPORT = {
    "setup": "taskboard",
    "seconds": 12.5,
    "streams": {
        "uplink_video": {
            "cap_bps": 90_000,
            "frames_sent": 7,
            "stale_ns": 2_500_000_000,
            "size": [320, 240],
            "state": "fresh",
            "gained_bps": None,
            "latency_ms": {"p99.9": 80.0, "count": 7},
        }
    },
    "link": {"uplink": {"octets": {"video": 9}, "octets_percent": {"video": 4.5}, "frames": 3}},
    "gateways": {"ground": {"supervision": {"begun_ns": 5, "counts": {"signals_lost": 2}}}},
    "processes": {"robot": {"cpu_s": 1.5, "restarts": 1, "counts": {"restarts": 4, "cycles": 100}}},
}


def exposed(report, problems=()):
    exposition = Exposition()
    exposition.report, exposition.problems = report, list(problems)
    families = list(text_string_to_metric_families(exposition.text().decode()))
    kinds = {family.name: family.type for family in families}
    samples = {
        (sample.name, *sorted(sample.labels.items())): sample.value
        for family in families
        for sample in family.samples
    }
    return kinds, samples


def test_keys_become_names_rows_become_labels_and_units_those_of_prometheus():
    kinds, samples = exposed(REPORT)
    stream = ("stream", "uplink_video")
    robot = ("process", "robot")
    assert samples == {
        ("kontur_healthy",): 1,
        ("kontur_setup", ("setup", "taskboard")): 1,
        ("kontur_seconds",): 12.5,
        ("kontur_stream_cap_bps", stream): 90_000,
        ("kontur_stream_frames_sent_total", stream): 7,
        ("kontur_stream_stale_seconds_total", stream): 2.5,
        ("kontur_stream_state", ("state", "fresh"), stream): 1,
        ("kontur_stream_latency_p99_9_seconds", stream): 0.08,
        ("kontur_stream_latency_values", stream): 7,
        ("kontur_link_bytes_total", ("direction", "uplink"), ("octets", "video")): 9,
        ("kontur_link_octets_percent", ("direction", "uplink"), ("octets_percent", "video")): 4.5,
        ("kontur_link_frames_total", ("direction", "uplink")): 3,
        ("kontur_gateway_supervision_begun_seconds", ("end", "ground")): 5e-9,
        (
            "kontur_gateway_supervision_counts_total",
            ("counts", "signals_lost"),
            ("end", "ground"),
        ): 2,
        ("kontur_process_cpu_seconds", robot): 1.5,
        ("kontur_process_restarts_total", robot): 1,
        ("kontur_process_counts_restarts_total", robot): 4,
        ("kontur_process_counts_cycles_total", robot): 100,
    }
    assert kinds["kontur_stream_frames_sent"] == "counter"
    assert kinds["kontur_stream_cap_bps"] == "gauge"


def test_a_session_with_problems_is_not_healthy():
    _, samples = exposed({}, ["robot does not come back"])
    assert samples == {("kontur_healthy",): 0}
