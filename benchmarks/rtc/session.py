"""Live sessions beside a leg to a partner that is idle, busy, full or cut."""

import json
import os
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from time import monotonic, sleep

from benchmarks.json_reader import JsonReader
from benchmarks.page.session import TIMEOUT_S, Session, live_session
from benchmarks.rtc.network import HOST, Network
from benchmarks.rtc.partner import write_units
from benchmarks.rtc.rtc_metrics import CUT, FULL, IDLE, NO_LEG, SessionRun
from kontur_av.topics.session_files import session_root
from pipelines.session.command_process import end_all

_PERCENTILES = ("p50", "p99")


def session_run(
    leg: str, units: Sequence[tuple[bytes, bool]], *, seconds: float, base_port: int, port: int
) -> SessionRun:
    """Run a session. leg: one of LEGS; all but NO_LEG and IDLE need a `Network`."""
    words = ["--base-port", str(base_port), "--radio", "clean", "--no-page"]
    alone = leg in (NO_LEG, IDLE)
    if leg != NO_LEG:
        words += ["--rtc", f"{'127.0.0.1' if alone else HOST}:{port}"]
    with ExitStack() as stack:
        network = None if alone else stack.enter_context(Network())
        session = stack.enter_context(live_session(words, seconds))
        if network is not None:
            if leg == FULL:
                network.thin()
            stack.enter_context(_partner(session, network, units))
            if leg == CUT:
                sleep(seconds / 2)
                network.cut()
        session.process.wait(seconds + TIMEOUT_S)
        report = JsonReader(json.loads(session.report.read_text()))
    return read_session(leg, report)


def read_session(leg: str, report: JsonReader) -> SessionRun:
    """The figures of a session's report."""
    streams = dict(report.items("streams"))
    video = report.at("rtc", "streams") if report.has("rtc", "streams", "rtc_video") else None
    return SessionRun(
        leg=leg,
        latency_ms={
            name: {each: row.number("latency_ms", each) for each in _PERCENTILES}
            for name, row in streams.items()
        },
        force_ms={each: report.number("haptic", "up", "latency_ms", each) for each in _PERCENTILES},
        slot_us=report.number("link", "uplink", "lateness_us", "p99"),
        lost=sum(row.count("rtp_lost") for row in streams.values()),
        cores=report.number("cpu", "cores_used"),
        partner_bps=None if video is None else report.count("rtc", "mean_bps", "rtc_video"),
        partner_lost=None if video is None else video.count("rtc_video", "lost"),
        failures=tuple(str(element.value) for element in report.elements("failures")),
    )


@contextmanager
def _partner(
    session: Session, network: Network, units: Sequence[tuple[bytes, bool]]
) -> Iterator[None]:
    """A partner in its own network, for as long as the session runs."""
    told = session_root(session.name) / "rtc.json"
    until_s = monotonic() + TIMEOUT_S
    while not told.exists() or not told.read_text().endswith("}\n"):
        if monotonic() > until_s or session.process.poll() is not None:
            raise RuntimeError("the session has no leg to a partner")
        sleep(0.05)
    said = json.loads(told.read_text())
    with TemporaryDirectory() as folder:
        file, trusted = Path(folder) / "units", Path(folder) / "cert.pem"
        write_units(file, units)
        trusted.write_bytes((told.parent / "rtc.pem").read_bytes())
        words = ("-m", "benchmarks.rtc.partner", said["base"], said["token"], str(file))
        process = subprocess.Popen(
            [*network.prefix, sys.executable, *words],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            env={**os.environ, "SSL_CERT_FILE": str(trusted)},
            start_new_session=True,
        )
        try:
            yield
        finally:
            end_all([process])
