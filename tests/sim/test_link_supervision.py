"""Two ends of supervision on virtual time, with a path between them that fails in every way."""

from collections import deque
from random import Random

import pytest

from telepresence.link.flows import tmtc_flow, video_flow, voice_flow
from telepresence.link.profile import DOWNLINK, UPLINK
from telepresence.link.supervision import (
    ApplicationReset,
    Configuration,
    ContextsHeld,
    LinkState,
    PeerDeaf,
    PeerHears,
    PeerMet,
    SignalAcquired,
    SignalLost,
    StateChanged,
    Supervisor,
)

MS = 1_000_000
S = 1000
UP = [tmtc_flow("tc"), voice_flow("voice"), video_flow("video")]
DOWN = [tmtc_flow("tm"), video_flow("video")]
GROUND = Configuration(transmit=UPLINK, transmit_flows=UP, receive=DOWNLINK, receive_flows=DOWN)
SPACE = Configuration(transmit=DOWNLINK, transmit_flows=DOWN, receive=UPLINK, receive_flows=UP)


class End:
    """A supervisor with the least gateway around it: application data each slot, if it has any."""

    def __init__(self, name, configuration, *, master):
        self.name, self.configuration, self.master = name, configuration, master
        self.supervisor = None
        self.life = 0
        self.sends = True
        #: Of every so many-th slot.
        self.period = 1
        self.events = []
        self.sent = []
        self.delivered = []

    def start(self, life, slot):
        self.life = life
        self.supervisor = Supervisor(
            master=self.master, configuration=self.configuration, life=life, now_ns=slot * MS
        )
        self.supervisor.handle_local_check(None, slot * MS)

    def of(self, kind):
        return [event for event in self.events if isinstance(event, kind)]


class Pair:
    """Ground is the master. `up` and `down` say of each slot whether its frame comes through."""

    def __init__(self, *, delay_slots=5, ground=GROUND, space=SPACE, masters=(True, False)):
        self.ground = End("ground", ground, master=masters[0])
        self.space = End("space", space, master=masters[1])
        self.ends = (self.ground, self.space)
        self.delay_slots = delay_slots
        self.paths = {"ground": deque(), "space": deque()}
        self.blocked = {"ground": False, "space": False}
        self.message_loss = 0.0
        self.garble = 0.0
        self.random = Random(1)
        self.slot = 0
        self.never_connected = False

    def start(self):
        self.ground.start(0x1111, self.slot)
        self.space.start(0x2222, self.slot)

    def run(self, slots):
        for _ in range(slots):
            self.step()
        return self

    def step(self):
        slot, now_ns = self.slot, self.slot * MS
        for end in self.ends:
            if end.supervisor is not None:
                self.transmit(end, slot, now_ns)
        for end, other in (self.ends, self.ends[::-1]):
            path = self.paths[end.name]
            while path and path[0][0] <= slot:
                _, message, data = path.popleft()
                if other.supervisor is not None:
                    self.arrive(other, message, data, now_ns + MS // 3)
        self.slot += 1
        both = [end.supervisor and end.supervisor.state for end in self.ends]
        assert not (self.never_connected and LinkState.CONNECTED in both)

    def arrive(self, end, message, data, now_ns):
        supervisor = end.supervisor
        supervisor.handle_frame(now_ns)
        if message is not None:
            supervisor.handle_message(message, now_ns)
        if data is not None and supervisor.delivering:
            end.delivered.append((now_ns, data))
            supervisor.handle_application(now_ns)
        self.drain(end)

    def transmit(self, end, slot, now_ns):
        data = None
        if end.sends and slot % end.period == 0:
            data = (end.life, slot)
            end.supervisor.handle_application_sent(now_ns)
        message = end.supervisor.poll_transmit(now_ns)
        self.drain(end)
        if message is not None:
            end.sent.append((slot, message))
            if self.random.random() < self.message_loss:
                message = data = None
            elif self.random.random() < self.garble:
                message = self.random.randbytes(12)
        if not self.blocked[end.name]:
            self.paths[end.name].append((slot + self.delay_slots, message, data))

    @staticmethod
    def drain(end):
        while event := end.supervisor.next_event():
            end.events.append(event)

    @property
    def states(self):
        return tuple(end.supervisor.state.name for end in self.ends)

    def history(self, end):
        report = end.supervisor.report(self.slot * MS)
        return [entry["to"] for entry in report["history"]]


CONNECTED = ("CONNECTED", "CONNECTED")


def connected(**options):
    pair = Pair(**options)
    pair.start()
    pair.run(4 * pair.delay_slots + 100)
    assert pair.states == CONNECTED
    return pair


@pytest.mark.parametrize("delay_slots", [0, 5, 15, 400])
def test_connects_in_two_round_trips_and_a_few_messages(delay_slots):
    pair = Pair(delay_slots=delay_slots)
    pair.start()
    while pair.states != CONNECTED:
        pair.step()
    assert pair.slot <= 5 * delay_slots + 100
    for end in pair.ends:
        states = pair.history(end)
        assert states[:3] == ["check", "search", "configure"]
        # Data that came before the two had agreed approves at once.
        assert states[3:] in (["connected"], ["approve", "connected"])
        assert len(end.of(SignalAcquired)) == len(end.of(PeerMet)) == len(end.of(PeerHears)) == 1
        assert not end.of(SignalLost) + end.of(PeerDeaf) + end.of(ApplicationReset)


@pytest.mark.parametrize("late", [30, 700, 10_000])
@pytest.mark.parametrize("first", ["ground", "space"])
def test_connects_however_late_one_side_starts(late, first):
    pair = Pair(delay_slots=12)
    one, other = pair.ends if first == "ground" else pair.ends[::-1]
    one.start(7, 0)
    pair.run(late)
    assert one.supervisor.state is LinkState.SEARCH
    other.start(8, pair.slot)
    pair.run(200)
    assert pair.states == CONNECTED


def test_settled_it_says_little_and_only_what_is_needed():
    pair = connected()
    # Each knows that the other is connected: no reason to go on insisting.
    assert max(len(end.sent) for end in pair.ends) <= 8
    pair.run(3 * S)
    assert max(len(end.sent) for end in pair.ends) <= 8 + 7
    before = [len(end.sent) for end in pair.ends]
    events = [len(end.events) for end in pair.ends]
    pair.run(20 * S)
    for end, sent, seen in zip(pair.ends, before, events, strict=True):
        assert len(end.sent) - sent <= 40
        assert all(isinstance(event, ContextsHeld) for event in end.events[seen:])


@pytest.mark.parametrize("blackout", [100, 1_000, 10_000])
@pytest.mark.parametrize("delay_slots", [0, 12, 400])
def test_blackout_both_ways(blackout, delay_slots):
    pair = connected(delay_slots=delay_slots)
    pair.run(7)
    pair.blocked = dict.fromkeys(pair.blocked, True)
    pair.run(blackout)
    pair.blocked = dict.fromkeys(pair.blocked, False)
    back = (pair.slot + delay_slots) * MS
    for end in pair.ends:
        end.events.clear()
        end.delivered.clear()
    pair.run(3 * delay_slots + 100)
    for end in pair.ends:
        # What is lost is noticed where it is, up to a delay after it began.
        record = end.supervisor.report(pair.slot * MS)["contacts"]
        assert len(record) == 2
        assert record[1]["acquired_ns"] - back <= MS
        assert record[1]["acquired_ns"] - record[0]["lost_ns"] == (blackout + 1) * MS
        if blackout > 50 + delay_slots:
            # The very first frame carries: this life had been checked.
            assert end.delivered[0][0] == record[1]["acquired_ns"]
    if delay_slots <= 12:
        assert pair.states == CONNECTED
    pair.run(1 * S)
    assert pair.states == CONNECTED
    for end in pair.ends:
        assert not end.of(PeerMet)


def test_loss_is_noticed_within_50_ms_of_the_last_frame():
    for slot in range(10):
        pair = connected(delay_slots=slot)
        pair.run(slot)
        pair.blocked["ground"] = True
        pair.run(60 + slot)
        (lost,) = pair.space.of(SignalLost)
        assert 0 < lost.now_ns - lost.last_ns <= 50 * MS
        assert not pair.ground.of(SignalLost)


@pytest.mark.parametrize("gap", [1, 20, 47])
def test_a_gap_below_the_limit_is_no_loss_of_signal(gap):
    pair = connected()
    pair.blocked = dict.fromkeys(pair.blocked, True)
    pair.run(gap)
    pair.blocked = dict.fromkeys(pair.blocked, False)
    pair.run(100)
    assert pair.states == CONNECTED
    assert not pair.ground.of(SignalLost) + pair.space.of(SignalLost)


@pytest.mark.parametrize("deaf", ["ground", "space"])
def test_one_direction_alive_keeps_carrying(deaf):
    pair = connected(delay_slots=12)
    hearing, lost = pair.ends if deaf == "space" else pair.ends[::-1]
    # The frames of `hearing` do not reach `lost` any more, but those of `lost` do come.
    pair.blocked[hearing.name] = True
    pair.run(200)
    assert lost.supervisor.state is LinkState.SEARCH
    assert hearing.supervisor.state is LinkState.CONFIGURE
    assert "does not hear" in hearing.supervisor.why
    assert not hearing.supervisor.peer_hears
    assert [type(event) for event in hearing.events if not isinstance(event, ContextsHeld)][
        -2:
    ] == [PeerDeaf, StateChanged]
    count = len(hearing.delivered)
    sent = len(lost.sent)
    pair.run(10 * S)
    assert len(hearing.delivered) - count == 10 * S
    # Messages into the void are dear, where the void may hear and the media share with them.
    assert len(lost.sent) - sent <= 10 * 20 + 100
    pair.blocked[hearing.name] = False
    pair.run(100 + 3 * 12)
    assert pair.states == CONNECTED
    assert lost.of(PeerHears)
    assert hearing.of(PeerHears)


def test_one_direction_alive_from_the_beginning():
    pair = Pair()
    pair.blocked["space"] = True
    pair.start()
    pair.run(100)
    assert pair.space.delivered[0][0] < 30 * MS
    assert pair.states == ("SEARCH", "CONFIGURE")
    pair.never_connected = True
    pair.run(20 * S)
    assert not pair.ground.delivered
    assert len(pair.space.of(StateChanged)) == 2


@pytest.mark.parametrize("who", ["ground", "space"])
@pytest.mark.parametrize("delay_slots", [0, 5, 400])
def test_a_new_life_of_either_side(who, delay_slots):
    pair = connected(delay_slots=delay_slots)
    one, other = pair.ends if who == "ground" else pair.ends[::-1]
    other.supervisor.handle_contexts((9, 8), pair.slot * MS)
    pair.run(2 * S)
    assert one.of(ContextsHeld)[-1].ids == (9, 8, 0, 0)
    for end in pair.ends:
        end.events.clear()
    one.start(0x7777, pair.slot)
    pair.run(6 * delay_slots + 100)
    assert pair.states == CONNECTED
    (met,) = other.of(PeerMet)
    assert met[1:] == (0x7777, True)
    # What the other holds of the former life is never said to be held of this one.
    assert {event.ids for event in one.of(ContextsHeld)} == {(0, 0, 0, 0)}
    assert not one.of(ApplicationReset) + other.of(ApplicationReset)


def test_a_frame_count_that_begins_anew_holds_delivery_until_the_next_message():
    pair = connected()
    supervisor = pair.ground.supervisor
    supervisor.handle_restart(pair.slot * MS)
    assert not supervisor.delivering
    pair.run(50)
    assert supervisor.delivering
    assert pair.states == CONNECTED


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
        (varied(version=2), "version"),
        (varied(receive_flows=UP[:2]), "frames or flows differ"),
        (
            varied(transmit=type(DOWNLINK)(name="downlink", frame_octets=400, scid=0x4C)),
            "downlink has",
        ),
    ],
)
@pytest.mark.parametrize("late", [0, 100])
def test_what_does_not_fit_is_refused_and_named(space, why, late):
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
    # Started again as it should be, it is taken at once.
    pair.never_connected = False
    pair.space.configuration = SPACE
    pair.space.start(3, pair.slot)
    pair.run(100)
    assert pair.states == CONNECTED


def test_a_new_life_that_does_not_fit_is_delivered_no_longer():
    pair = connected()
    pair.space.configuration = varied(receive_flows=UP[:2])
    pair.space.start(0x3333, pair.slot)
    pair.run(50)
    pair.never_connected = True
    count = len(pair.ground.delivered)
    pair.run(2 * S)
    assert pair.states == ("REFUSED", "REFUSED")
    assert len(pair.ground.delivered) == count


@pytest.mark.parametrize("masters", [(True, True), (False, False)])
def test_two_of_the_same_role_refuse_each_other(masters):
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


def test_a_link_without_programs_idles_for_minutes_and_is_there_at_once():
    pair = Pair()
    for end in pair.ends:
        end.sends = False
    pair.start()
    pair.run(5 * S)
    sent = [len(end.sent) for end in pair.ends]
    changes = [len(end.of(StateChanged)) for end in pair.ends]
    pair.run(90 * S)
    assert pair.states == ("APPROVE", "APPROVE")
    for end, messages, changed in zip(pair.ends, sent, changes, strict=True):
        assert len(end.sent) - messages <= 2 * 90
        assert len(end.of(StateChanged)) == changed
        assert not end.of(ApplicationReset)
    for end in pair.ends:
        end.sends = True
    pair.run(40)
    assert pair.states == CONNECTED


@pytest.mark.parametrize("sends", ["ground", "space"])
def test_data_one_way_is_no_fault(sends):
    pair = Pair()
    for end in pair.ends:
        end.sends = end.name == sends
    pair.start()
    pair.run(20 * S)
    assert pair.states == ("APPROVE", "APPROVE")
    for end in pair.ends:
        assert not end.of(ApplicationReset)
    # A packet against the stream every five seconds, as RTCP: connected, and so it stays.
    for end in pair.ends:
        if not end.sends:
            end.sends, end.period = True, 5 * S
    pair.run(6 * S)
    assert pair.states == CONNECTED
    changes = [len(end.of(StateChanged)) for end in pair.ends]
    pair.run(20 * S)
    assert changes == [len(end.of(StateChanged)) for end in pair.ends]


@pytest.mark.parametrize("first", ["ground", "space"])
def test_an_idle_link_is_reset_once_and_approved_anew_by_data_both_ways(first):
    pair = connected()
    for end in pair.ends:
        end.sends = False
    pair.run(20 * S)
    assert pair.states == ("APPROVE", "APPROVE")
    resets = pair.ground.of(ApplicationReset) + pair.space.of(ApplicationReset)
    assert {reset.why for reset in resets} == {"idle"}
    assert max(len(end.of(ApplicationReset)) for end in pair.ends) == 1
    for end in pair.ends:
        end.sends = end.name == first
    pair.run(3 * S)
    assert pair.states == ("APPROVE", "APPROVE")
    for end in pair.ends:
        end.sends = True
    pair.run(50)
    assert pair.states == CONNECTED


def test_a_broken_application_link_is_reset_again_and_again_but_ever_less_often():
    pair = connected()

    # What the ground sends gets lost between its receiver and the applications of space.
    def arrive(end, message, data, now_ns):
        Pair.arrive(pair, end, message, None if end is pair.space else data, now_ns)

    pair.arrive = arrive
    pair.run(100 * S)
    assert pair.states == ("APPROVE", "APPROVE")
    resets = [event.now_ns for event in pair.space.of(ApplicationReset)]
    assert {event.why for event in pair.space.of(ApplicationReset)} == {"broken"}
    assert 3 <= len(resets) <= 6
    assert 2 * S * MS <= resets[1] - resets[0] < resets[-1] - resets[-2]
    assert not pair.ground.of(ApplicationReset)
    del pair.arrive
    pair.run(50)
    assert pair.states == CONNECTED


def test_a_slave_that_never_confirms_is_asked_anew_with_patience():
    supervisor = Supervisor(master=True, configuration=GROUND, life=5, now_ns=0)
    supervisor.handle_local_check(None, 0)
    slave = Supervisor(master=False, configuration=SPACE, life=6, now_ns=0)
    slave.handle_local_check(None, 0)
    slave.handle_message(supervisor.poll_transmit(0), 0)
    # It hears its master, and has not been configured yet.
    stuck = slave.poll_transmit(10 * MS)
    for slot in range(1, 100 * S):
        supervisor.handle_frame(slot * MS)
        if slot % 20 == 0:
            supervisor.handle_message(stuck, slot * MS)
        supervisor.poll_transmit(slot * MS)
    report = supervisor.report(100 * S * MS)
    assert report["state"] == "configure"
    assert 3 <= report["counts"]["timeouts_answer"] <= 6
    assert any("time-out" in entry["why"] for entry in report["history"])


def test_frames_without_messages_time_out():
    pair = connected()
    for slot in range(pair.slot, pair.slot + 10 * S):
        pair.ground.supervisor.handle_frame(slot * MS)
        pair.ground.supervisor.poll_transmit(slot * MS)
        pair.drain(pair.ground)
    assert pair.ground.supervisor.state is LinkState.SEARCH
    assert pair.ground.of(PeerDeaf)
    assert pair.ground.supervisor.delivering


def test_contexts_are_told_at_once_and_again():
    pair = connected()
    pair.run(3 * S)
    pair.space.supervisor.handle_contexts((3, 0), pair.slot * MS)
    pair.run(7)
    assert pair.ground.of(ContextsHeld)[-1].ids == (3, 0, 0, 0)
    pair.ground.events.clear()
    pair.run(2 * S)
    assert {event.ids for event in pair.ground.of(ContextsHeld)} == {(3, 0, 0, 0)}
    # Contexts that change all the time do not take the channel.
    sent = len(pair.space.sent)
    for number in range(S):
        pair.space.supervisor.handle_contexts((1 + number % 255,), pair.slot * MS)
        pair.step()
    assert len(pair.space.sent) - sent <= 51


def test_single_messages_that_are_wrong_break_nothing():
    pair = connected()
    pair.garble = 0.5
    events = len(pair.ground.events)
    pair.run(40 * S)
    assert pair.states == CONNECTED
    for end in pair.ends:
        counts = end.supervisor.report(pair.slot * MS)["counts"]
        assert counts["messages_malformed"] + counts["messages_mismatched"] > 20
        assert not end.of(PeerDeaf) + end.of(SignalLost) + end.of(ApplicationReset)
        assert len(end.of(PeerMet)) == 1
    assert len(pair.ground.events) > events


@pytest.mark.parametrize("seed", range(8))
def test_whatever_happened_it_ends_connected(seed):
    """Blackouts, lost and garbled messages, restarts, faults; then the link is left alone."""
    random = Random(seed)
    pair = Pair(delay_slots=random.choice((0, 1, 7, 40, 130, 400)))
    pair.message_loss, pair.garble = random.choice((0.0, 0.3)), random.choice((0.0, 0.1))
    pair.random = Random(seed + 1000)
    life = 1
    pair.start()
    for _ in range(30):
        what = random.randrange(6)
        end = random.choice(pair.ends)
        if what < 2:
            pair.blocked[end.name] = not pair.blocked[end.name]
        elif what == 2:
            pair.blocked = dict.fromkeys(pair.blocked, random.random() < 0.5)
        elif what == 3:
            life += 1
            end.start(life, pair.slot)
        elif what == 4:
            fault = random.choice((None, "a fault"))
            end.supervisor.handle_local_check(fault, pair.slot * MS)
        else:
            end.sends = not end.sends
        for _ in range(random.choice((1, 30, 60, 300, 2000))):
            pair.step()
            for one in pair.ends:
                if one.supervisor.state is LinkState.CONNECTED:
                    assert one.supervisor.signal
                    assert one.supervisor.peer_hears
                    assert one.supervisor.delivering
    pair.blocked = dict.fromkeys(pair.blocked, False)
    for end in pair.ends:
        end.supervisor.handle_local_check(None, pair.slot * MS)
        end.sends = True
    pair.run(4 * pair.delay_slots + 1500)
    assert pair.states == CONNECTED
    changes = [len(end.of(StateChanged)) for end in pair.ends]
    resets = [len(end.of(ApplicationReset)) for end in pair.ends]
    pair.run(10 * S)
    assert changes == [len(end.of(StateChanged)) for end in pair.ends]
    assert resets == [len(end.of(ApplicationReset)) for end in pair.ends]


def test_the_same_course_gives_the_same_report():
    reports = []
    for _ in range(2):
        pair = connected(delay_slots=12)
        pair.message_loss = 0.3
        pair.blocked["ground"] = True
        pair.run(300)
        pair.blocked["ground"] = False
        pair.run(300)
        reports.append([end.supervisor.report(pair.slot * MS) for end in pair.ends])
    assert reports[0] == reports[1]
    ground = reports[0][0]
    assert sum(ground["in_state_ns"].values()) == pair.slot * MS
    assert len(ground["history"]) <= 64
