"""Two ends: over a network that carries less for a while; in network namespaces, behind NATs."""

import contextlib
import json
import os
import signal
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import pytest
from common import eventually, free_port
from running_end import RunningEnd
from running_session import BOARD, SMALL
from two_hosts import GROUND_PUBLIC, PORT, TwoHosts

from pipelines.link.relay import PathRelay
from telepresence.link.radio.network import Network, NetworkPath


@pytest.fixture
def hosts():
    with TwoHosts() as hosts:
        yield hosts


@pytest.fixture
def start_end(hosts, keys, tmp_path):
    """start_end(end): `kontur-av stream --end` on its host; space calls ground."""
    with contextlib.ExitStack() as stack:

        def start(end):
            at = f"{GROUND_PUBLIC}:{PORT}"
            where = ("--listen", f"0.0.0.0:{PORT}") if end == "ground" else ("--peer", at)
            return stack.enter_context(
                RunningEnd(
                    *(SMALL, end, *where, "--key", keys[end]),
                    directory=tmp_path / f"{end}{time.monotonic_ns()}",
                    prefix=hosts.prefix(end),
                )
            )

        yield start


def is_silent(end):
    """Whether nothing came out at an end in three further lines of figures."""
    lines, shown = len(end.lines()), end.shown()
    eventually(lambda: len(end.lines()) > lines + 3, "lines of figures")
    return end.shown() == shown


def test_a_session_on_two_machines_outlives_kills_a_cut_cable_and_a_new_address(hosts, start_end):
    ends = {end: start_end(end) for end in ("space", "ground")}
    back_s = {}

    def flowing(what, began_s):
        with ThreadPoolExecutor() as pool:
            # Twice, because the first figures may be of before.
            for _ in range(2):
                list(pool.map(RunningEnd.wait_for_flow, ends.values()))
        back_s[what] = round(time.monotonic() - began_s, 1)

    flowing("start", time.monotonic())
    began_s = time.monotonic()
    killed = {end: running.pids()[f"{end}_gateway"] for end, running in ends.items()}
    for end, running in ends.items():
        os.kill(killed[end], signal.SIGKILL)
        eventually(lambda r=running, p=killed[end]: p not in r.children(), "the end of its life")
        eventually(lambda r=running: len(r.children()) == len(r.names), "another life")
    flowing("both gateways killed", began_s)
    ends["ground"].process.kill()
    ends["ground"].process.wait()
    ends["ground"] = start_end("ground")
    flowing("the ground end killed and started again", time.monotonic())
    hosts.cut("space")
    for running in ends.values():
        eventually(lambda end=running: is_silent(end), "the loss of signal")
    hosts.fix("space")
    flowing("the cable of space out", time.monotonic())
    hosts.move_space()
    flowing("the address of space changed", time.monotonic())
    reports = {}
    for end, running in ends.items():
        reports[end] = running.finish()
        assert reports[end]["failures"] == []
        for name, stream in reports[end]["streams"].items():
            assert (stream["payload_bps_max_1s"] or 0) <= stream["cap_bps"], name
    assert reports["ground"]["gateways"]["ground"]["peer"]["address_changes"] >= 1
    print(json.dumps(back_s))


def test_a_session_follows_what_a_network_carries_that_loses_and_reorders(keys, tmp_path):
    bad = Network(delay_ms=5, loss=0.01, reordered=0.1, reorder_ms=12, repeated=0.01)
    at, (down, up) = ("127.0.0.1", free_port()), (NetworkPath(bad, seed) for seed in (1, 2))
    relay, stop = PathRelay(at, down, up, time.monotonic_ns), threading.Event()
    thread = threading.Thread(target=relay.run, args=(stop.is_set,), daemon=True)
    thread.start()
    where = (("ground", "--listen", at[1]), ("space", "--peer", relay.address[1]))
    with contextlib.ExitStack() as stack:
        ends = {}
        for name, option, port in where:
            words = ("--path", "compact", "--path-batch-ms", "4", "--key", keys[name])
            words = (option, f"127.0.0.1:{port}", *words)
            end = RunningEnd(BOARD, name, *words, directory=tmp_path / name)
            ends[name] = stack.enter_context(end)
            # It has its ports, so that the other end takes others.
            end.pids()
        ground, space = ends.values()
        ground.wait_for_flow()
        space.wait_for_flow()
        # The operator's picture passes a bottleneck with a queue, which cannot carry all of it.
        up._rates_bps = [270_000]
        eventually(lambda: "at most" in ground.lines()[-1].replace("at most 90", ""), "lower caps")
        for end in (ground, space):
            end.wait_for_flow([name for name in end.shown() if "haptic" in name])
        up._rates_bps = [0]
        eventually(lambda: "video at most" not in ground.lines()[-1], "the whole profile")
        space.wait_for_flow()
        for name, end in ends.items():
            peer = end.finish()["gateways"][name]["peer"]
            assert peer["bundled"] and peer["compact"] and peer["frames_put_back"] > 0
            assert end is space or "over the path" in str(peer["events"])
    stop.set()
    thread.join()
