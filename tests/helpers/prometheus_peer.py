"""Debian's Prometheus, which reads the figures of a session."""

import json
import shutil
import subprocess
import urllib.parse
import urllib.request

import pytest
from positions import ROOT

SAMPLES = ROOT / "samples" / "monitoring"
PROMETHEUS = shutil.which("prometheus")
needs_prometheus = pytest.mark.skipif(
    PROMETHEUS is None, reason="prometheus: apt-get install prometheus"
)


def fetched(url):
    with urllib.request.urlopen(url, timeout=10) as answer:
        return answer.read().decode()


class PrometheusPeer:
    """It reads the session's port once a second."""

    def __init__(self, directory, port, own_port):
        self._port = own_port
        config = (SAMPLES / "prometheus.yml").read_text().replace("9270", str(port))
        (directory / "prometheus.yml").write_text(config.replace("interval: 5s", "interval: 1s"))
        shutil.copy(SAMPLES / "alerts.yml", directory)
        self.process = subprocess.Popen(
            [
                PROMETHEUS,
                f"--config.file={directory / 'prometheus.yml'}",
                f"--storage.tsdb.path={directory / 'data'}",
                f"--web.listen-address=127.0.0.1:{own_port}",
            ],
            stderr=subprocess.DEVNULL,
        )

    def scraped(self):
        """What it has read last, by name and labels; {} before the first time."""
        query = urllib.parse.urlencode({"query": '{job="kontur-av"}'})
        try:
            told = json.loads(fetched(f"http://127.0.0.1:{self._port}/api/v1/query?{query}"))
        except OSError:
            return {}
        return {
            (
                row["metric"].pop("__name__"),
                *sorted((k, v) for k, v in row["metric"].items() if k not in ("job", "instance")),
            ): float(row["value"][1])
            for row in told["data"]["result"]
        }
