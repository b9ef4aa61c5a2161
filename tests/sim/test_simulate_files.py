"""Files beside a session on virtual time: in what the media leave, across contacts."""

from dataclasses import replace
from random import Random

from kontur_av.clock import NS_PER_MS, NS_PER_S
from pipelines.session.setup.segments import Segment
from pipelines.session.setup.setup_file import load_setup
from pipelines.session.topology.topics import FILES
from pipelines.virtual.session import Simulation
from pipelines.virtual.workers import Workers
from telepresence.files.entity import DONE, RUNNING, SUSPENDED
from telepresence.link.radio import load_radio

#: Three contacts, of 4, 3 and 3.5 s.
RADIO = """
delay_ms = 2.0
[[blackouts]]
start_s = 4.0
seconds = 1.0
[[blackouts]]
start_s = 8.0
seconds = 1.0
"""
SECONDS = 12.5
DOWN = Random(1).randbytes(200_000)
UP = Random(2).randbytes(3_000)


def session(tmp_path, *, files):
    path = tmp_path / "radio.toml"
    path.write_text(RADIO)
    setup = replace(load_setup("spacejustin"), radio=load_radio(str(path)))
    states = []
    with Workers() as workers:
        simulation = Simulation(setup, workers, seed=1, files=files)
        if files:
            transfers = simulation.files
            transfers.directories[Segment.SPACE]["down.bin"] = DOWN
            transfers.directories[Segment.GROUND]["up.bin"] = UP
            sent = transfers.put(Segment.SPACE, "down.bin", 0)
            transfers.put(Segment.GROUND, "up.bin", 0)
            for at_s in (3.0, 4.8, 7.0, 8.8):
                simulation.run(round(at_s * NS_PER_S))
                states.append((transfers.entities[Segment.SPACE].state_of(sent), sent.octets))
        simulation.run(round(SECONDS * NS_PER_S))
        if files:
            states.append((sent.state, sent.octets))
            assert transfers.directories[Segment.GROUND]["down.bin"] == DOWN
            assert transfers.directories[Segment.SPACE]["up.bin"] == UP
        return simulation.report(), states


def test_200_kb_come_down_across_three_contacts_and_take_nothing_from_the_media(tmp_path):
    plain, _ = session(tmp_path, files=False)
    report, states = session(tmp_path, files=True)
    assert [state for state, _ in states] == [RUNNING, SUSPENDED, RUNNING, SUSPENDED, DONE]
    octets = [so_far for _, so_far in states]
    assert octets == sorted(set(octets)), octets
    for name, stream in report.streams.items():
        before, beside = plain.streams[name].latency_ms, stream.latency_ms
        assert before.count > 0
        assert (beside.p50, beside.p99, beside.count) == (before.p50, before.p99, before.count)
    assert report.haptic == plain.haptic
    assert [link.loop.slips for link in report.link.values()] == [0, 0]
    metrics = report.processes[FILES[Segment.SPACE]].counts
    assert metrics["file_octets_sent"] == len(DOWN)
    # Only what was on its way at a loss of signal is sent again.
    assert metrics["file_octets_resent"] < 5_000
    assert 1_500 < metrics["file_suspended_ns"] / NS_PER_MS < 3_000
