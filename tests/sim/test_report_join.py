"""Two ends' reports of one session, joined, are the report of the same session on one machine."""

import array

import msgspec
import numpy as np
import pytest
from told import message, processes

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.errors import ConfigError, ProtocolError
from pipelines.cli import main
from pipelines.report import join
from pipelines.report.collector import Collector
from pipelines.report.model import EndTrace, SessionReport, from_json, to_json
from pipelines.report.session_report import build_report
from pipelines.session.probe import Message, Series
from pipelines.session.session_metrics import INSTANTS, ClockRow
from pipelines.session.setup.segments import Segment
from pipelines.session.setup.setup_file import load_setup, setup_from_text
from pipelines.session.setup.setup_text import setup_toml
from pipelines.table import topology_of
from pipelines.virtual.simulate import simulate

SECONDS = 8.5
#: The clock of space runs ahead by this, and its instants count from another start.
AHEAD_NS = 3_217 * NS_PER_MS
ERROR_NS = 300_000
WALL_OFFSETS_NS = {Segment.GROUND: 5 * NS_PER_S, Segment.SPACE: 5_000 * NS_PER_S}


def join_reports(first, second):
    return join.join_reports(first, second, read_setup=setup_from_text, table_of=topology_of)


class Twice(Collector):
    """Takes the messages of a whole session, and passes each on to the end that sent it."""

    def __init__(self, topology):
        super().__init__(topology)
        self.setup = setup = topology.setup
        self.ends = {
            segment: Collector(topology_of(setup, segments=(segment,))) for segment in Segment
        }
        gateways = {segment: self.topology.gateway(segment).name for segment in Segment}
        for segment, end in self.ends.items():
            ahead_ns = AHEAD_NS if segment is Segment.GROUND else -AHEAD_NS
            at_ns = own_ns(segment, 0)
            row = ClockRow(at_ns, ahead_ns, ERROR_NS)
            end.handle_message(gateways[segment], message(rows=[row]), at_ns)

    def handle_message(self, process, told, now_ns):
        super().handle_message(process, told, now_ns)
        segment = self.topology.process(process).segment
        moved = Message(told.metrics)
        moved.series = [moved_series(segment, series) for series in told.series]
        self.ends[segment].handle_message(process, moved, own_ns(segment, now_ns))

    def report_of(self, segment, seconds):
        """The report of one end, as its launcher writes it."""
        end = self.ends[segment]
        names = list(end.processes)
        report = build_report(
            end,
            seconds=seconds,
            processes=processes(names),
        )
        trace = EndTrace(
            setup=setup_toml(self.setup),
            wall_offset_ns=WALL_OFFSETS_NS[segment],
            began_ns=own_ns(segment, 0),
            ended_ns=own_ns(segment, round(seconds * NS_PER_S)),
            lives=[11 if segment is Segment.GROUND else 12],
            peers=[12 if segment is Segment.GROUND else 11],
            series=end.trace.report(),
        )
        written = to_json(msgspec.structs.replace(report, trace=trace))
        return from_json(written, SessionReport)


def own_ns(segment, true_ns):
    """An instant of the simulation on the clock of an end."""
    wall_ns = true_ns + WALL_OFFSETS_NS[Segment.GROUND]
    if segment is Segment.SPACE:
        wall_ns += AHEAD_NS
    # Clocks count from long before the session.
    return wall_ns - WALL_OFFSETS_NS[segment] + 10_000 * NS_PER_S


def moved_series(segment, series):
    rows = np.array(series.values, np.int64).reshape(-1, series.width)
    for column in INSTANTS[series.kind]:
        rows[:, series.kind._fields.index(column)] += own_ns(segment, 0)
    return Series(series.kind, series.stream, array.array("q", rows.tobytes()))


@pytest.fixture(scope="module")
def session():
    """The collector of a simulated session, and its report."""
    made = []

    def collect(topology):
        made.append(Twice(topology))
        return made[0]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("pipelines.virtual.session.Collector", collect)
        report = simulate(load_setup("spacejustin"), seconds=SECONDS, seed=1)
    return made[0], report


@pytest.fixture(scope="module")
def ends(session):
    return [session[0].report_of(segment, SECONDS) for segment in Segment]


@pytest.fixture(scope="module")
def joined(ends):
    return join_reports(*ends)


def test_what_both_ends_know_together_is_what_one_machine_would_have_known(session, joined):
    whole = session[1]
    for name, stream in whole.streams.items():
        found = joined.streams[name]
        assert found.latency_ms.count == pytest.approx(stream.latency_ms.count, abs=2), name
        for rank in ("p50", "p95", "p99"):
            expected = getattr(stream.latency_ms, rank)
            assert getattr(found.latency_ms, rank) == pytest.approx(expected, rel=0.01), name
        for stage in ("capture_to_encoded", "sent_to_received"):
            expected = getattr(stream.latency_ms.stages, stage).p50
            measured = getattr(found.latency_ms.stages, stage)
            assert measured.count and measured.p50 == pytest.approx(expected, rel=0.02)
        for field in ("side", "cap_bps", "rtp", "display", "payload_bps_max_1s", "pauses_s"):
            assert getattr(found, field) == getattr(stream, field), (name, field)
        assert found.sender.frames_sent == stream.sender.frames_sent
    for key, row in whole.haptic.items():
        found = joined.haptic[key]
        assert found.sender.sent == row.sender.sent and found.side is None
        assert found.receiver.received == row.receiver.received
        assert found.latency_ms == row.latency_ms
    assert joined.link == whole.link
    for name, skew in whole.skew_ms.items():
        assert joined.skew_ms[name].p50 == pytest.approx(skew.p50, abs=0.2), name
    lead_ms = whole.video_lead.lead_ms.total
    assert joined.video_lead.lead_ms.total == pytest.approx(lead_ms, rel=0.02)
    assert joined.sync.events == whole.sync.events > 0
    for sense, metrics in whole.sync.senses.items():
        assert joined.sync.senses[sense].latency_ms == metrics.latency_ms, sense
    assert joined.lip_sync.within == pytest.approx(whole.lip_sync.within, abs=0.01)
    assert set(joined.processes) == set(whole.processes)


def test_the_error_between_the_clocks_is_stated(joined):
    # It grows from the only estimate on, by the largest drift between two clocks.
    for stream in joined.streams.values():
        assert ERROR_NS / 1e6 < stream.latency_error_ms < ERROR_NS / 1e6 + SECONDS
    assert joined.end is None and joined.trace is None
    assert set(joined.gateways) == {"ground", "space"}


def test_the_order_does_not_matter_and_the_clock_of_either_end_will_do(ends, joined):
    ground, space = ends
    assert join_reports(space, ground) == joined
    without = [series for series in space.trace.series if series.kind != "Clock"]
    trace = msgspec.structs.replace(space.trace, series=without)
    again = join_reports(ground, msgspec.structs.replace(space, trace=trace))
    assert again.haptic == joined.haptic


@pytest.mark.parametrize("radio", ["cable", "mine", "none.toml"])
def test_the_command_writes_a_report_that_reads_like_any(ends, joined, tmp_path, capsys, radio):
    paths = [tmp_path / f"{report.end}.json" for report in ends]
    for path, report in zip(paths, ends, strict=True):
        setup = report.trace.setup.replace('radio = "cable"', f'radio = "{radio}"')
        path.write_text(to_json(changed(report, setup=setup)))
    assert main(["report", "join", *map(str, paths)]) == 0
    # A radio profile of one's own is there by its name alone.
    assert from_json(capsys.readouterr().out, SessionReport).streams == joined.streams


OTHER = "name = 'x'\ncameras = ['head']\n[uplink_video]\ncap_kbps = 60\n"


def changed(report, **trace):
    return msgspec.structs.replace(report, trace=msgspec.structs.replace(report.trace, **trace))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda ground, space: (ground, ground), "both reports are of the end ground"),
        (lambda ground, space: (ground, msgspec.structs.replace(space, end=None)), "whole session"),
        (lambda ground, space: (ground, changed(space, lives=[99], peers=[98])), "never met"),
        (lambda ground, space: (ground, changed(space, setup=OTHER)), "different streams"),
        (lambda *ends: (ends[0], changed(ends[1], began_ns=1, ended_ns=2)), "not run at the same"),
        (lambda *ends: [changed(end, series=[]) for end in ends], "neither end knew"),
    ],
)
def test_reports_that_do_not_belong_together_are_refused_in_one_line(ends, change, words):
    with pytest.raises(ConfigError, match=words):
        join_reports(*change(*ends))


def test_a_damaged_trace_is_refused(ends):
    ground, space = ends
    (first, *rest) = space.trace.series
    (block, *_) = first.blocks
    for wrong in (
        msgspec.structs.replace(block, octets="AAAA"),
        msgspec.structs.replace(block, octets="no Base64 at all"),
        msgspec.structs.replace(block, rows=block.rows + 1),
        msgspec.structs.replace(block, rows=1 << 40),
        msgspec.structs.replace(block, rows=0),
    ):
        series = [msgspec.structs.replace(first, blocks=[wrong]), *rest]
        with pytest.raises(ProtocolError):
            join_reports(ground, changed(space, series=series))
    unknown = msgspec.structs.replace(first, kind="Lateness")
    with pytest.raises(ProtocolError, match="no rows 'Lateness'"):
        join_reports(ground, changed(space, series=[unknown]))
