"""A session's figures in Debian's Prometheus, beside the report."""

import json
import re
import shutil
import signal
import subprocess
import urllib.parse
import urllib.request
from pathlib import Path

import pytest
from janus_room import free_port
from prometheus_client.parser import text_string_to_metric_families
from running_session import assert_sound, eventually

from pipelines.report.exposition import Exposition

pytestmark = pytest.mark.realtime

SAMPLES = Path(__file__).resolve().parents[2] / "samples" / "monitoring"
PROMETHEUS = shutil.which("prometheus")


def samples(text):
    return {
        (one.name, *sorted(one.labels.items())): one.value
        for family in text_string_to_metric_families(text)
        for one in family.samples
    }


def fetched(url):
    with urllib.request.urlopen(url, timeout=10) as answer:
        return answer.read().decode()


def scraped(port):
    """What Prometheus has read last, by name and labels; {} before the first time."""
    query = urllib.parse.urlencode({"query": '{job="kontur-av"}'})
    told = json.loads(fetched(f"http://127.0.0.1:{port}/api/v1/query?{query}"))
    return {
        (
            row["metric"].pop("__name__"),
            *sorted((k, v) for k, v in row["metric"].items() if k not in ("job", "instance")),
        ): float(row["value"][1])
        for row in told["data"]["result"]
    }


@pytest.mark.skipif(PROMETHEUS is None, reason="Debian's prometheus is not installed")
def test_prometheus_reads_what_the_report_says(start, tmp_path):
    port, web = free_port(), free_port()
    session = start("taskboard", "--metrics", str(port))
    session.wait_for_flow()
    config = (SAMPLES / "prometheus.yml").read_text().replace("9270", str(port))
    (tmp_path / "prometheus.yml").write_text(config.replace("interval: 5s", "interval: 1s"))
    shutil.copy(SAMPLES / "alerts.yml", tmp_path)
    peer = subprocess.Popen(
        [
            PROMETHEUS,
            f"--config.file={tmp_path / 'prometheus.yml'}",
            f"--storage.tsdb.path={tmp_path / 'data'}",
            f"--web.listen-address=127.0.0.1:{web}",
        ],
        stderr=subprocess.DEVNULL,
    )
    sent = ("kontur_stream_frames_sent_total", ("stream", "uplink_video"))
    try:

        def figures():
            try:
                return scraped(web).get(sent) and scraped(web)
            except OSError:
                return None

        found = eventually(figures, "figures in Prometheus")
        assert fetched(f"http://127.0.0.1:{port}/healthz") == "well\n"
    finally:
        # Prometheus dies without a word, which changes nothing.
        peer.send_signal(signal.SIGKILL)
        peer.wait()
    own = fetched(f"http://127.0.0.1:{port}/metrics")
    lint = subprocess.run(["promtool", "check", "metrics"], input=own, text=True, check=False)
    assert lint.returncode == 0
    code, report = session.interrupt()
    assert code == 0, (session.errors(), report["failures"])
    assert_sound(report)
    exposition = Exposition()
    exposition.report = report
    at_the_end = samples(exposition.text().decode())
    counters = [key for key in found if key[0].endswith("_total")]
    assert len(counters) > 200
    for key in counters:
        assert found[key] <= at_the_end[key], key
    named = {name for name, *_ in at_the_end} | {"kontur_av"}
    for file in ("alerts.yml", "dashboard.json"):
        words = re.findall(r"kontur_\w+", (SAMPLES / file).read_text())
        assert words and set(words) <= named, file
    subprocess.run(["promtool", "check", "config", SAMPLES / "prometheus.yml"], check=True)
