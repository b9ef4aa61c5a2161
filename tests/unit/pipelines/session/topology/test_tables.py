"""The topology as text: tables fit a narrow terminal uncut, and the graph is well formed."""

import re

import pytest
from positions import ROOT

from pipelines.cli import main
from pipelines.session.setup.segments import Segment
from pipelines.session.setup.setup_file import BUILT_IN
from pipelines.session.topology.tables import (
    dot,
    ports_table,
    processes_table,
    streams_table,
    topics_table,
)
from pipelines.table import topology_of

SESSION = topology_of(BUILT_IN["spacejustin"], snapshots=True, pages=True)
EDGE = re.compile(
    r'  "([\w/]+)" -> "([\w/]+)" \[(?:label="[^"]*", )?style=(solid|dashed|bold)'
    r"(?:, arrow(?:head|tail)=none)?(, dir=back)?\];"
)


@pytest.mark.parametrize("width", [80, 100, 250])
def test_tables_fit_the_width_and_cut_nothing(width):
    tables = processes_table(SESSION), streams_table(SESSION), topics_table(SESSION)
    for table, rows in zip(
        tables, (SESSION.processes, SESSION.streams, SESSION.topics), strict=True
    ):
        lines = table.lines(width)
        assert max(map(len, lines)) <= width
        assert {row.name for row in rows} <= {line.split(" ")[0] for line in lines}
    for row in SESSION.streams:
        (line,) = [
            line for line in streams_table(SESSION).lines(80) if line.startswith(f"{row.name} ")
        ]
        assert [str(row.entry_port), str(row.exit_port)] == re.findall(r"\b\d{5}\b", line)
    words = " ".join(" ".join(topics_table(SESSION).lines(80)).split())
    assert (
        "camera_left, camera_right, camera_static, camera_head, ground_mic, operator_camera"
        in words
    )


def test_the_graph_is_well_formed_and_every_arrow_points_at_what_takes():
    text = dot(SESSION)
    assert text.count("{") == text.count("}") == 3
    assert text.startswith('digraph "spacejustin" {\n') and text.endswith("}\n")
    known = {row.name for row in SESSION.processes}
    assert set(re.findall(r'^ +"(\w+)";$', text, re.MULTILINE)) == known
    # A topic with many readers is a node, too.
    known |= set(re.findall(r'^ +"(\w+/\w+)" \[shape=plaintext', text, re.MULTILINE))
    joined = set()
    for line in (line for line in text.splitlines() if "->" in line):
        match = EDGE.fullmatch(line)
        assert match, line
        joined |= set(match.groups()[:2])
    assert joined == known
    arrows = {
        (match[2], match[1]) if match[4] else (match[1], match[2])
        for match in EDGE.finditer(dot(SESSION))
    }
    for topic in SESSION.topics:
        for reader in topic.readers:
            through = {(topic.writer, topic.name), (topic.name, reader)}
            assert (topic.writer, reader) in arrows or through <= arrows
    for row in SESSION.streams:
        link = SESSION.link(row.direction)
        assert (link.sender, link.receiver) in arrows
        if row.sender is not None:
            assert {(row.sender, link.sender), (link.receiver, row.receiver)} <= arrows


@pytest.mark.parametrize("name", BUILT_IN)
def test_every_channel_of_a_setup_has_a_line_with_its_documented_ports(name):
    session = topology_of(BUILT_IN[name])
    table = ports_table(session, list(Segment), "127.0.0.1", "127.0.0.1")
    rows = {row[0]: row[1:3] for row in table.rows}
    known = [(row.name, row.entry_port, row.exit_port) for row in session.streams]
    for stream, *ports in known:
        assert rows[stream] == tuple(f"127.0.0.1:{port}" for port in ports)
    text = (ROOT / "docs" / "own-programs.md").read_text(encoding="utf-8")
    written = [line.split("|") for line in text.splitlines() if line.startswith("| `")]
    lacks = "voice|downlink_video" if name == "taskboard" else "nothing"
    assert known == [
        (row[1].strip(" `"), int(row[3]), int(row[4]))
        for row in written
        if not re.search(lacks, row[1])
    ]


def test_one_end_shows_its_own_ports_only_and_the_command_prints_tables_or_a_graph(
    capsys, monkeypatch
):
    lines = ports_table(SESSION, [Segment.GROUND], "198.51.100.1", "198.51.100.2").lines(200)
    video = next(line for line in lines if line.startswith("uplink_video "))
    assert "198.51.100.1:27010" in video and "the other end" in video
    down = next(line for line in lines if line.startswith("downlink_video "))
    assert "198.51.100.2:27020" in down
    both = [set(SESSION.ports_of(SESSION.gateway(end).name)) for end in Segment]
    assert both[0] & both[1] == set()
    for end, bound in zip(Segment, both, strict=True):
        shown = {row.entry_port for row in SESSION.streams if row.direction.sender is end}
        assert len(bound - shown) == 1  # the radio's
    monkeypatch.setenv("COLUMNS", "80")
    assert main(["topology", "--setup", "taskboard"]) == 0
    told = capsys.readouterr().out
    assert "uplink_video_send" in told and "robot/state" in told and "downlink_voice" not in told
    assert main(["topology", "--setup", "taskboard", "--dot", "--base-port", "28000"]) == 0
    assert capsys.readouterr().out.startswith("digraph")
