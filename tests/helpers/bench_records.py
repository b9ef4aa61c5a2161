"""A run that `kontur-av bench all` could have kept."""

from benchmarks.all.records import Record
from benchmarks.machine import Machine
from pipelines.report.result import Headline

MACHINE = Machine(cpu="Some CPU", cores=2, kernel="Linux 6", python="3.11.7", pyav="18.1.0")
RECORD = Record(
    name="latency",
    title="Latency",
    command="kontur-av bench latency --seconds 10",
    number=1,
    date="2026-03-04T05:06:07+00:00",
    code="0123456789ab",
    machine=MACHINE,
    failure="",
    headlines=(
        Headline(
            what="picture, p99", who="live", unit="ms", value=40.0, target="<= 45 ms", met=True
        ),
        Headline(what="picture, p99", who="virtual", unit="ms", value=39.5),
    ),
)
