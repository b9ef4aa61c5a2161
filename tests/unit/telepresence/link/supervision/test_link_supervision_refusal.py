"""Ends that do not match are refused, and the difference is named."""

import pytest
from link_supervision_pair import CONNECTED, DOWN, MS, SPACE, UP, Pair, S, connected

from telepresence.link.profile import DOWNLINK, UPLINK
from telepresence.link.supervision.message import Configuration, LinkState
from telepresence.link.supervision.record import StateChanged


def varied(**changes):
    table = {
        "transmit": DOWNLINK,
        "transmit_flows": DOWN,
        "receive": UPLINK,
        "receive_flows": UP,
        **changes,
    }
    return Configuration(**table)


@pytest.mark.parametrize(
    ("space", "why"),
    [
        (varied(version=4), "version"),
        (varied(receive_flows=UP[:2]), "frames or flows differ"),
        (
            varied(transmit=type(DOWNLINK)(name="downlink", frame_octets=400, scid=0x4C)),
            "downlink has",
        ),
    ],
)
@pytest.mark.parametrize("late", [0, 100])
def test_a_mismatch_is_refused_and_named(space, why, late):
    pair = Pair(space=space)
    pair.never_connected = True
    pair.ground.start(1, 0)
    pair.run(late)
    pair.space.start(2, late)
    pair.run(20 * S)
    for end in pair.ends:
        assert end.supervisor.state is LinkState.REFUSED
        assert why in end.supervisor.why
        assert not end.delivered
        assert not end.supervisor.delivering
        assert len(end.sent) < 20 * 20 + 100
        assert "refused" in pair.history(end)
    # Restarted with the right configuration, it is accepted at once.
    pair.never_connected = False
    pair.space.configuration = SPACE
    pair.space.start(3, pair.slot)
    pair.run(100)
    assert pair.states == CONNECTED


def test_a_mismatching_new_life_stops_delivery():
    pair = connected()
    pair.space.configuration = varied(receive_flows=UP[:2])
    pair.space.start(0x3333, pair.slot)
    # Until the loss of the old life's signal is noticed: a stranger cannot end a live connection.
    pair.run(50 + pair.delay_slots)
    pair.never_connected = True
    count = len(pair.ground.delivered)
    pair.run(2 * S)
    assert pair.states == ("REFUSED", "REFUSED")
    assert len(pair.ground.delivered) == count


@pytest.mark.parametrize("masters", [(True, True), (False, False)])
def test_two_ends_with_the_same_role_refuse_each_other(masters):
    pair = Pair(masters=masters)
    pair.never_connected = True
    pair.start()
    pair.run(5 * S)
    assert pair.states == ("REFUSED", "REFUSED")
    assert f"both ends are {'master' if masters[0] else 'slave'}" in pair.ground.supervisor.why
    assert not pair.ground.delivered + pair.space.delivered


def test_the_local_check_comes_first():
    pair = connected()
    pair.space.supervisor.handle_local_check("no robot", pair.slot * MS)
    pair.run(50)
    assert pair.states == ("CONFIGURE", "CHECK")
    assert "local check" in pair.ground.supervisor.why
    count = len(pair.space.delivered)
    pair.never_connected = True
    pair.run(20 * S)
    assert pair.states == ("CONFIGURE", "CHECK")
    assert len(pair.space.delivered) == count
    assert len(pair.ground.of(StateChanged)) < 10
    pair.never_connected = False
    pair.space.supervisor.handle_local_check(None, pair.slot * MS)
    pair.run(50)
    assert pair.states == CONNECTED
