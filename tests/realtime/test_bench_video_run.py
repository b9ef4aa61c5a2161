"""`bench video` with real processes and sockets, for a few seconds and in a small size."""

import json

import pytest

from benchmarks.__main__ import main as benchmark
from benchmarks.video.peers import CONTENDERS
from benchmarks.video.targets import DEFAULT
from pipelines.bench.video.quality import OURS
from pipelines.cli import main


@pytest.mark.parametrize("name", [OURS, DEFAULT])
def test_a_short_run_gives_metrics(name, tmp_path, capsys):
    if (reason := CONTENDERS[name].missing()) is not None:
        pytest.skip(reason)
    report, plot = tmp_path / "figures.json", tmp_path / "latency.png"
    options = ["--seconds", "8", "--size", "320x240", "--report", str(report), "--plot", str(plot)]
    if name == OURS:
        assert main(["bench", "video", *options]) == 0
    else:
        assert benchmark(["video", *options, "--only", name, "--only", "scene"]) == 0
    assert plot.read_bytes().startswith(b"\x89PNG")
    printed = capsys.readouterr().out
    assert "capture to displayed, p99" in printed
    metrics = json.loads(report.read_text())
    assert {one["who"] for one in metrics.pop("headlines")} >= {name}
    (rate,) = metrics.values()
    found = rate["scene"][name]
    latencies = found["latencies_ms"]
    # The machine decides how many pictures come and how late, but some come, and none early.
    assert 0 < len(latencies) <= 240
    assert min(latencies) > 0
    assert found["latency_ms"]["max"] == pytest.approx(max(latencies), abs=0.001)
    assert found["unreadable"] == 0
    assert found["psnr_db"]["mean"] > 20
    assert found["rtp_1s_bps"] > found["payload_1s_bps"] > 10_000
    assert min(found["sender_cpu_s"], found["receiver_cpu_s"]) > 0
    if name == OURS:
        assert found["payload_1s_bps"] <= 85_000
        assert found["answers"] > 0, "no report of the receiver came back"
        met = {verdict["what"]: verdict["met"] for verdict in rate["scene"]["targets"]}
        assert met["largest 1 s window of payload"]
