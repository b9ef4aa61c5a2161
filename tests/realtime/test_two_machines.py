"""Two ends in network namespaces: hosts behind NATs, and an attacker on the path between them."""

import contextlib
import json
import os
import signal
import time
from concurrent.futures import ThreadPoolExecutor

import pytest
from path_relay import KINDS, Relay
from running_end import RunningEnd
from running_link import RunningLink, eventually
from two_hosts import GROUND_PUBLIC, OUTSIDE, PORT, TwoHosts

from pipelines.link.key_files import make_key, trust

#: Datagrams of each kind of attack, each way.
ATTACKS = int(os.environ.get("KONTUR_ATTACKS", "200"))


@pytest.fixture
def hosts():
    with TwoHosts() as hosts:
        yield hosts


@pytest.fixture
def keys(tmp_path):
    """The key files of ground, space and a stranger; ground and space trust each other."""
    paths = {name: tmp_path / f"{name}.pem" for name in ("ground", "space", "stranger")}
    identities = {name: make_key(path).identity for name, path in paths.items()}
    trust(paths["ground"], identities["space"])
    trust(paths["space"], identities["ground"])
    trust(paths["stranger"], identities["ground"])
    return paths


@pytest.fixture
def start(hosts, keys, tmp_path):
    """start(host, end, peer=…): an end of `kontur-av link` on a host; it listens, or calls."""
    with contextlib.ExitStack() as stack:

        def start_link(host, end=None, *, peer=None, key=None, name=None):
            where = ("--peer", peer) if peer else ("--listen", f"0.0.0.0:{PORT}")
            return stack.enter_context(
                RunningLink(
                    *("--setup", "spacejustin", "--end", end or host, *where),
                    *("--key", keys[key or host]),
                    directory=tmp_path,
                    name=name or host,
                    prefix=hosts.prefix(host),
                    base_port=27_000,
                )
            )

        yield start_link


def peer_of(report):
    (gateway,) = report["gateways"].values()
    return gateway["peer"]


def relayed(relay, more):
    """Wait until the relay has passed on `more` further datagrams each way."""
    before = relay.order("figures")
    eventually(
        lambda: all(
            now["relayed"] >= before[way]["relayed"] + more
            for way, now in relay.order("figures").items()
        ),
        "the path carries datagrams both ways",
    )


def test_an_attacker_on_the_path_changes_nothing(hosts, start):
    """It flips, cuts, extends, repeats and invents datagrams; each is dropped and counted."""
    listen, to = f"{OUTSIDE}:{PORT}", f"{GROUND_PUBLIC}:{PORT}"
    with Relay(hosts.prefix("outside"), listen, to, delay_ms=2) as relay:
        # What it keeps of this session is replayed into the next one.
        with start("ground", name="before") as first, start("space", peer=listen) as space:
            relayed(relay, 1000)
            _, before = first.interrupt()
            relay.order("mark")
            ground = start("ground")
            relayed(relay, 3000)
            for kind in KINDS:
                relay.order("attack", kind, ATTACKS)
            eventually(
                lambda: all(
                    way.get(kind, 0) == ATTACKS
                    for way in relay.order("figures").values()
                    for kind in KINDS
                ),
                "all attacks",
            )
            relayed(relay, 500)
            (code_ground, at_ground), (code_space, in_space) = ground.interrupt(), space.interrupt()
        sent = relay.order("figures")
    assert code_ground == code_space == 0
    from_ground = peer_of(before)["sent"] + peer_of(at_ground)["sent"]
    for report, genuine, way in (
        (at_ground, peer_of(in_space)["sent"], sent["to_far"]),
        (in_space, from_ground, sent["to_near"]),
    ):
        peer = peer_of(report)
        assert sum(peer["dropped"].values()) >= len(KINDS) * ATTACKS
        print(json.dumps(way), json.dumps(peer))
        # What was taken is genuine and comes once. `stray`: of the peer before its restart.
        assert peer["taken"] <= genuine
        received = report["link"]["downlink" if report is at_ground else "uplink"]
        assert set(received["frames_dropped"]) <= {"stray"}
    # Attacks begin no session and end none.
    assert peer_of(at_ground)["sessions"] == 1
    assert peer_of(in_space)["sessions"] == 2


def test_an_end_with_another_key_gets_no_session_and_disturbs_none(hosts, start):
    at = f"{GROUND_PUBLIC}:{PORT}"
    with start("ground") as ground, start("space", peer=at) as space:
        ground.wait_for_line("path 203")
        stranger = start("outside", "space", peer=at, key="stranger")
        stranger.wait_for_line("no session")
        stranger.wait_for_line("no session")
        _, of_stranger = stranger.interrupt()
        (_, at_ground), (_, in_space) = ground.interrupt(), space.interrupt()
    assert peer_of(of_stranger)["sessions"] == peer_of(of_stranger)["taken"] == 0
    assert peer_of(at_ground)["sessions"] == peer_of(in_space)["sessions"] == 1
    assert peer_of(at_ground)["address_changes"] == 0
    # Nobody answers a knock that is not sealed for the two identities.
    assert peer_of(at_ground)["dropped"]["unauthenticated"] > 0


@pytest.fixture
def start_end(hosts, keys, tmp_path):
    """start_end(end): `kontur-av stream --end` on its host; space calls ground."""
    with contextlib.ExitStack() as stack:

        def start(end):
            at = f"{GROUND_PUBLIC}:{PORT}"
            where = ("--listen", f"0.0.0.0:{PORT}") if end == "ground" else ("--peer", at)
            return stack.enter_context(
                RunningEnd(
                    *("spacejustin", end, *where, "--key", keys[end]),
                    directory=tmp_path / f"{end}{time.monotonic_ns()}",
                    prefix=hosts.prefix(end),
                )
            )

        yield start


def test_a_session_on_two_machines_outlives_kills_a_cut_cable_and_a_new_address(hosts, start_end):
    ends = {end: start_end(end) for end in ("space", "ground")}
    back_s = {}

    def flowing(what, began_s):
        with ThreadPoolExecutor() as pool:
            list(pool.map(RunningEnd.wait_for_flow, ends.values()))
        back_s[what] = round(time.monotonic() - began_s, 1)

    flowing("start", time.monotonic())
    for end in ends:
        os.kill(ends[end].pids()[f"{end}_gateway"], signal.SIGKILL)
        flowing(f"the {end} gateway killed", time.monotonic())
    for end in ends:
        ends[end].process.kill()
        ends[end].process.wait()
        ends[end] = start_end(end)
        flowing(f"the {end} end killed and started again", time.monotonic())
    hosts.cut("space")
    time.sleep(2.5)
    hosts.mend("space")
    flowing("the cable of space out for 2.5 s", time.monotonic())
    hosts.move_space()
    flowing("the address of space changed", time.monotonic())
    reports = {}
    for end, running in ends.items():
        code, reports[end] = running.interrupt()
        assert code == 0, running.errors()
        assert reports[end]["failures"] == []
        for name, stream in reports[end]["streams"].items():
            assert (stream["payload_bps_max_1s"] or 0) <= stream["cap_bps"], name
    assert peer_of(reports["ground"])["address_changes"] >= 1
    print(json.dumps(back_s))
