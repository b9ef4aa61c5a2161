"""How many connections a server keeps: a stranger keeps nobody out who has a token."""

from pipelines.session.access import (
    MOST_CONNECTIONS,
    MOST_OF_ADDRESS,
    MOST_STRANGERS,
    STRANGER_NS,
    Doorway,
)


def test_idle_strangers_make_room_and_known_connections_stay():
    door = Doorway()
    door.handle_accepted(0, "operator", 0)
    door.handle_known(0)
    closed = []
    for number in range(1, 1401):
        closed += door.handle_accepted(number, f"host {number % 50}", number)
    assert len(closed) == door.closed == 1400 - MOST_STRANGERS
    assert 0 not in closed
    # The newest stay long enough to show their token.
    assert closed == list(range(1, 1401 - MOST_STRANGERS))
    for number in range(1401, 1401 + 100):
        door.handle_accepted(number, "lan", 2000)
        door.handle_known(number)
    assert len(door) == 101 + MOST_STRANGERS - 1


def test_one_address_has_fewer():
    door = Doorway()
    door.handle_accepted(0, "other", 0)
    closed = [one for n in range(1, 100) for one in door.handle_accepted(n, "same", 0)]
    assert closed == list(range(1, 100 - MOST_OF_ADDRESS))


def test_strangers_have_little_time_and_the_known_have_all():
    door = Doorway()
    for number in range(3):
        door.handle_accepted(number, "a", 0)
    door.handle_known(1)
    assert door.handle_time(STRANGER_NS - 1) == []
    assert door.handle_time(STRANGER_NS) == [0, 2]
    assert door.handle_time(10 * STRANGER_NS) == []
    door.handle_closed(1)
    door.handle_closed(1)
    assert len(door) == 0


def test_beyond_all_connections_a_new_stranger_is_closed():
    door = Doorway()
    for number in range(MOST_CONNECTIONS):
        door.handle_accepted(number, f"{number}", 0)
        door.handle_known(number)
    assert door.handle_accepted(1000, "late", 0) == [1000]
