"""A session's figures in Debian's Prometheus, beside the report."""

import contextlib
import os
import re
import signal
import subprocess

from prometheus_client.parser import text_string_to_metric_families
from prometheus_peer import SAMPLES, PrometheusPeer, fetched, needs_prometheus
from running_session import BOARD, eventually, tcp_port

from pipelines.report.exposition import Exposition


def samples(text):
    return {
        (sample.name, *sorted(sample.labels.items())): sample.value
        for family in text_string_to_metric_families(text)
        for sample in family.samples
    }


@needs_prometheus
def test_prometheus_reads_what_the_report_says(start, tmp_path):
    port = tcp_port()
    session = start(BOARD, "--metrics", str(port))
    session.wait_for_flow()
    peer = PrometheusPeer(tmp_path, port, tcp_port())
    sent = ("kontur_stream_frames_sent_total", ("stream", "uplink_video"))

    def tells(path, word):
        with contextlib.suppress(OSError):
            return word in fetched(f"http://127.0.0.1:{port}/{path}")

    try:

        def metrics():
            found = {key: one for key, one in peer.scraped().items() if key[0].endswith("_total")}
            return found if found.get(sent) and len(found) > 200 else None

        found = eventually(metrics, "figures in Prometheus")
        eventually(lambda: tells("healthz", "well\n"), "health")
    finally:
        # Prometheus dies without a word, which changes nothing.
        peer.process.kill()
        peer.process.wait()
    # The next start of a killed process serves the figures at the same address.
    os.kill(session.pids()["metrics"], signal.SIGKILL)
    eventually(lambda: tells("metrics", sent[0]), "figures after the kill")
    own = fetched(f"http://127.0.0.1:{port}/metrics")
    lint = subprocess.run(["promtool", "check", "metrics"], input=own, text=True, check=False)
    assert lint.returncode == 0
    report = session.finish(sound=True)
    exposition = Exposition()
    exposition.report = report
    at_the_end = samples(exposition.text().decode())
    for key in found:
        assert found[key] <= at_the_end[key], key
    named = {name for name, *_ in at_the_end} | {"kontur_av"}
    for file in ("alerts.yml", "dashboard.json"):
        words = re.findall(r"kontur_\w+", (SAMPLES / file).read_text())
        assert words and set(words) <= named, file
    subprocess.run(["promtool", "check", "config", SAMPLES / "prometheus.yml"], check=True)
