"""What `benchmarks record` makes of torn files and of reports."""

import json
from dataclasses import replace

import pytest
from synthetic_recording import LINK_CYCLES, LINK_NS, MS, PUBLISHED_NS, write_recording

from benchmarks.__main__ import main
from benchmarks.json_reader import JsonReader
from benchmarks.record.agreement import compare
from benchmarks.record.record_metrics import Kill, RecordResult, headlines
from benchmarks.record.recount import recount


def test_a_longer_loss_or_damage_is_a_failure():
    good = Kill(lost_s=0.4, gap_s=0.9, damaged=False, missing=0)
    for bad in ({}, {"lost_s": 1.01}, {"damaged": True}):
        result = RecordResult(
            setup="spacejustin", seconds=5, kills=(good, replace(good, **bad)), cuts=None,
            without=(), recorded=(),
        )  # fmt: skip
        assert result.sound is not bool(bad)
        assert any(headline.met is False for headline in headlines(result)) is bool(bad)


SECONDS = 3.0


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    return write_recording(tmp_path_factory.mktemp("counted") / "a.mcap", seconds=SECONDS, parts=2)


@pytest.fixture(scope="module")
def counted(written):
    return recount(written.paths[0])


def latency(ms):
    return {"p50": ms, "p95": ms, "count": 1}


def stream_report(counted, name):
    octets = counted.octets[f"/{name}/sent"]
    return {
        "frames_sent": counted.units[f"/{name}/sent"],
        "frames_displayed": len(counted.latencies_ms[f"/{name}/received"]),
        "payload_bps_mean": octets * 8 / SECONDS,
        "latency_ms": latency((LINK_NS + PUBLISHED_NS) / MS),
    }


def report_of(counted):
    """What the report of this session would say."""
    links = {
        name: {
            "frames": sent.frames,
            "frames_lost": counted.newest_received[name].frames_lost,
            "frames_dropped": {"fecf": counted.newest_received[name].frames_dropped},
            "octets": {each.what: each.octets for each in sent.carried},
        }
        for name, sent in counted.newest_sent.items()
    }
    haptic = {"sent": 3000, "latency_ms": latency(LINK_CYCLES)}
    streams = {name: stream_report(counted, name) for name in ("uplink_video", "uplink_voice")}
    streams["uplink_video"]["coded_size"] = [320, 240]
    kept = {topic: {"kept": count} for topic, count in counted.messages.items()}
    return {
        "seconds": SECONDS,
        "streams": streams,
        "haptic": {"up": haptic, "down": dict(haptic)},
        "link": links,
        "recorder": {"channels": kept},
    }


def test_a_recording_agrees_with_its_report_and_what_differs_is_found(counted, written):
    assert counted.units["/uplink_video/sent"] == len(written.units["uplink_video"])
    assert counted.messages.total() == sum(map(len, written.told.values()))
    assert counted.samples_sent("up") == (3000, 0)
    found = compare(counted, JsonReader(report_of(counted)))
    assert [one.what for one in found if not one.agrees] == []
    assert {"ms", "bit/s", ""} == {one.unit for one in found}
    report = report_of(counted)
    report["streams"]["uplink_video"]["frames_sent"] += 2
    report["streams"]["uplink_voice"]["latency_ms"] = latency(LINK_NS / MS)
    report["haptic"]["up"]["sent"] += 300
    report["haptic"]["down"]["latency_ms"] = latency(LINK_CYCLES + 2)
    report["link"]["uplink"]["frames_lost"] += 300
    report["recorder"]["channels"]["/events"]["kept"] -= 1
    found = compare(counted, JsonReader(report))
    assert sorted(one.what for one in found if not one.agrees) == [
        *("/events, messages", "haptic_down, latency p50", "haptic_down, latency p95"),
        *("haptic_up, samples sent", "uplink, frames lost", "uplink_video, units sent"),
        *("uplink_voice, latency p50", "uplink_voice, latency p95"),
    ]


def test_the_command_compares_files_or_refuses_them_in_one_line(written, counted, tmp_path, capsys):
    report, words = tmp_path / "a.json", ("record", "--compare")
    report.write_text(json.dumps(report_of(counted)))
    assert main([*words, str(written.paths[0]), str(report)]) == 0
    assert " 0 differ" in capsys.readouterr().out
    torn, other = tmp_path / "torn.mcap", tmp_path / "other.json"
    torn.write_bytes(written.paths[0].read_bytes()[:-100])
    other.write_text("{}")
    for recording, told, why in (
        (torn, report, "is no whole MCAP file"),
        (tmp_path / "none.mcap", report, "cannot be read"),
        (written.paths[0], other, "is no report of a recorded session"),
        (written.paths[0], torn, "is no JSON"),
    ):
        assert main([*words, str(recording), str(told)]) == 2
        error = capsys.readouterr().err
        assert why in error and error.count("\n") == 1
