"""The age of what is shown, and for how long it was stale, frozen or damaged."""

from kontur_av.clock import NS_PER_MS as MS
from kontur_av.streams.staleness import Staleness, State


class Display:
    """Pictures that are stale after 200 ms and frozen after 66 ms; instants and times in ms."""

    def __init__(self):
        self.staleness = Staleness(stale_after_ns=200 * MS, frozen_after_ns=66 * MS)
        self.last_ms = -33

    def show(self, duration_ms, latency_ms=40, *, damaged=False, pause_ms=33):
        """Show a picture every 33 ms, the first of them after a pause."""
        for at_ms in range(self.last_ms + pause_ms, self.last_ms + duration_ms + 1, 33):
            captured_ns = (at_ms - latency_ms) * MS
            self.staleness.handle_shown(captured_ns, at_ms * MS, damaged=damaged)
            last_ms = at_ms
        self.last_ms = last_ms

    def state(self, later_ms=0):
        return self.staleness.state((self.last_ms + later_ms) * MS)

    def age_ms(self, later_ms=0):
        age_ns = self.staleness.age_ns((self.last_ms + later_ms) * MS)
        return age_ns if age_ns is None else age_ns // MS


def spell(found):
    """Return for how many ms something was so, and how often."""
    return found.total_ns / MS, found.episodes


def test_age_grows_between_pictures():
    display = Display()
    assert (display.age_ms(), display.state()) == (None, State.NOTHING)
    display.show(363)
    assert [display.age_ms(later) for later in (0, 10, 500)] == [40, 50, 540]
    assert [display.state(later) for later in (65, 66, 159, 160)] == [
        *(State.FRESH, State.FROZEN, State.FROZEN, State.STALE)
    ]
    assert display.staleness.stale_from_ns() == (display.last_ms + 160) * MS


def test_a_missing_stream_is_frozen_then_stale_until_it_returns():
    display = Display()
    display.show(363)
    for later_ms in range(0, 1000, 70):
        display.staleness.handle_time((display.last_ms + later_ms) * MS)
    display.show(1330, pause_ms=1000)
    staleness = display.staleness
    assert spell(staleness.frozen) == (1000 - 66, 1)
    assert spell(staleness.stale) == (1000 - 160, 1)
    assert spell(staleness.damaged) == (0, 0)


def test_continuously_old_pictures_are_one_stale_episode():
    display = Display()
    display.show(1023, latency_ms=300)
    assert spell(display.staleness.stale) == (display.last_ms, 1)
    display.show(330)
    display.show(330, latency_ms=300)
    assert display.staleness.stale.episodes == 2
    assert display.staleness.frozen.total_ns == 0
    # Two between two checks count as two.
    staleness = Display().staleness
    staleness.handle_shown(0, 40 * MS)
    staleness.handle_shown(960 * MS, 1000 * MS)
    staleness.handle_time(2000 * MS)
    assert spell(staleness.stale) == (800 + 840, 2)
    assert staleness.frozen.episodes == 2


def test_damage_lasts_until_a_whole_picture_is_shown():
    display = Display()
    display.show(363)
    display.show(330, damaged=True)
    assert display.state() is State.DAMAGED
    display.show(330)
    assert spell(display.staleness.damaged) == (330, 1)


def test_a_block_of_sound_is_new_while_it_is_played():
    for latency_ms, stale in ((90, (20, 1)), (110, (230, 1))):
        staleness = Staleness(stale_after_ns=100 * MS, span_ns=20 * MS)
        for at_ms in range(0, 200, 20):
            staleness.handle_shown((at_ms - latency_ms) * MS, at_ms * MS)
            assert staleness.age_ns((at_ms + 19) * MS) == latency_ms * MS
        assert staleness.age_ns(220 * MS) == (latency_ms + 20) * MS
        # A block that is heard too late is stale from its start.
        staleness.handle_time(230 * MS)
        assert spell(staleness.stale) == stale


def test_a_picture_of_the_future_is_stale_and_its_age_unknown():
    display = Display()
    display.show(363, latency_ms=-50)
    assert display.state() is State.FRESH
    display.show(330, latency_ms=-3_600_000)
    assert (display.state(), display.age_ms()) == (State.STALE, None)
    display.show(330)
    assert display.state() is State.FRESH and display.staleness.stale.episodes == 1
