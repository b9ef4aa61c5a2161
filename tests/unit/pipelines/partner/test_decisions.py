"""Decisions about a partner: who is admitted, when to connect again, how to code the picture."""

import pytest

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.codecs.coding import Coding
from pipelines.partner import decisions


@pytest.mark.rule("10")
def test_only_the_token_opens_the_door_and_many_strangers_are_turned_away_unread():
    admission = decisions.Admission(token="secret")
    assert admission.check("Bearer secret", 0) is None
    assert admission.check("bearer  secret ", 0) is None
    wrong = (None, "", "Bearer", "Bearer secre", "Basic secret", "Bearer s\udcffcret")
    statuses = [admission.check(given, 0).status for given in (*wrong, *["Bearer guess"] * 24)]
    assert statuses == [401] * 10 + [429] * 20
    # Not those who have the token; and in the next second unknown senders are answered again.
    assert admission.check("Bearer secret", 0) is None
    assert admission.check("Bearer guess", NS_PER_S).status == 401
    assert admission.refused == {"token": 11, "unknown_senders": 20}
    admission = decisions.Admission(token="secret", most_viewers=2)
    assert admission.check_offer(viewers=1, now_ns=0) is None
    assert admission.check_offer(viewers=2, now_ns=0).status == 503
    offers = [admission.check_offer(viewers=None, now_ns=0) for _ in range(4)]
    assert offers[:3] == [None] * 3 and offers[3].status == 429


def test_who_watches_does_not_steer_and_who_steers_is_displaced_by_the_owner_alone():
    admission = decisions.Admission(token="seen", hand_token="hand")
    for token, steers, status in (
        *(("seen", False, None), ("seen", True, 403), ("hand", True, None)),
        *(("hand", False, 403), ("seen", None, None), ("hand", None, None)),
        *(("", True, 401), ("guess", None, 401)),
    ):
        refusal = admission.check(f"Bearer {token}", 0, steers=steers)
        assert (refusal and refusal.status) == status, (token, steers)
    assert decisions.Admission(token="seen").check("Bearer ", 0, steers=True).status == 401
    # The present one was heard a second ago, or three.
    for heard_ns, lent, status in (
        *((2 * NS_PER_S, True, 409), (2 * NS_PER_S, False, None)),
        *((0, True, None), (None, True, None)),
    ):
        refusal = admission.check_hand(heard_ns=heard_ns, lent=lent, now_ns=3 * NS_PER_S)
        assert (refusal and refusal.status) == status, (heard_ns, lent)


def connect(attempts, now_ns):
    while not attempts.poll_connect(now_ns):
        now_ns = attempts.poll_timeout()
    return now_ns


def test_attempts_wait_ever_longer_until_a_connection_was_good():
    attempts, now_ns, waits = decisions.Attempts(), 0, []
    for _ in range(9):
        begun_ns = connect(attempts, now_ns)
        waits.append((begun_ns - now_ns) / NS_PER_S)
        now_ns = begun_ns + NS_PER_S
        attempts.handle_ended(now_ns)
    assert waits == [0, 0.5, 1, 2, 4, 8, 16, 30, 30]
    # One that falls at once is no better than none.
    for life_s, wait_s in ((1, 30), (11, 0.5)):
        now_ns = connect(attempts, now_ns)
        attempts.handle_connected(now_ns)
        now_ns += life_s * NS_PER_S
        attempts.handle_ended(now_ns)
        assert attempts.poll_timeout() == now_ns + wait_s * NS_PER_S


def test_a_silent_partner_gets_one_restart_of_ice_and_then_a_new_connection():
    attempts = decisions.Attempts()
    attempts.poll_connect(0)
    assert not attempts.poll_restart(silent=True, now_ns=0)
    attempts.handle_connected(0)
    # It is silent, heard again, and then no more.
    for second, silent, restarted in (
        *((1, False, False), (2, True, True), (3, True, False)),
        *((4, False, False), (9, True, True)),
    ):
        assert attempts.poll_restart(silent=silent, now_ns=second * NS_PER_S) is restarted
        if not silent:
            assert attempts.doing is decisions.Doing.CONNECTED
    assert not attempts.is_hopeless(16 * NS_PER_S)
    assert attempts.is_hopeless(18 * NS_PER_S)


def test_the_rate_follows_a_wish_only_below_what_is_sent_and_grows_back():
    rate = decisions.RateFollower(most_bps=1_500_000)
    # A calm scene: the partner saw little, so its estimate is low, and limits nothing.
    assert not rate.handle_request(300_000, 200_000, 0)
    assert rate.handle_request(600_000, 1_400_000, NS_PER_S)
    assert rate.bps == 600_000
    # A difference that is not worth a key picture, and one that comes too soon.
    assert not rate.handle_request(560_000, 600_000, 3 * NS_PER_S)
    assert not rate.handle_request(300_000, 600_000, NS_PER_S + NS_PER_MS)
    assert rate.handle_request(1, 600_000, 3 * NS_PER_S)
    assert rate.bps == decisions.LEAST_BPS
    now_ns, steps = 3 * NS_PER_S, 0
    while rate.bps < 1_500_000:
        now_ns += 500 * NS_PER_MS
        steps += rate.handle_request(None, 90_000, now_ns)
        assert now_ns < 100 * NS_PER_S
    assert 10 <= steps <= 14
    assert rate.lowered == 2


def test_a_picture_is_skipped_after_large_ones_and_a_missing_unit_asks_for_a_key_picture():
    plan = decisions.PicturePlan(bps=800_000)
    assert plan.handle_picture(0).keyframe
    # 250 ms at this rate.
    plan.handle_coded(25_000, 0)
    assert plan.handle_picture(33 * NS_PER_MS) is None
    assert plan.handle_picture(133 * NS_PER_MS) == Coding()
    assert plan.skipped == 1
    plan.handle_key_request()
    plan.handle_rate(400_000)
    changed = plan.handle_picture(400 * NS_PER_MS)
    assert (changed.keyframe, changed.cap_bps) == (True, 400_000)
    plan = decisions.UplinkRequest(most_bps=1_000_000)
    told = [(7, True), (8, False), (10, False), (11, False), (13, True)]
    wanted = [plan.handle_unit(number, 100, key=key, now_ns=number) for number, key in told]
    assert wanted == [False, False, True, False, False]
    plan.handle_key_wanted()
    assert plan.request(watched=True) == decisions.CodingRequest(1_000_000, 2)
    assert plan.request(watched=False) == decisions.CodingRequest(0, 2)
