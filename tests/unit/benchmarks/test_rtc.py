"""The figures of the leg to a partner."""

from benchmarks.rtc.rtc_metrics import (
    CUT,
    NO_LEG,
    OURS,
    PEER,
    PixelRun,
    ReceptionRun,
    RtcResult,
    SessionRun,
    headlines,
)
from pipelines.report.result import spread


def session(leg, p99, lost=0):
    partner = {"partner_bps": None, "partner_lost": None}
    if leg != NO_LEG:
        partner = {"partner_bps": 1_400_000, "partner_lost": 7}
    latency_ms = {"uplink_video": {"p50": 40.0, "p99": p99}}
    known = {"force_ms": {"p50": 1.0, "p99": 2.0}, "slot_us": 80.0, "cores": 1.3, "failures": ()}
    return SessionRun(leg=leg, latency_ms=latency_ms, lost=lost, **known, **partner)


def reception(who, ms):
    one = spread([ms])
    return ReceptionRun(who=who, picture_ms=one, voice_ms=one, pictures=1, clicks=1)


def test_each_leg_and_each_receiver_has_its_column_and_a_loss_over_the_radio_is_a_miss():
    pixels = [PixelRun(pixel_ms=spread([ms]), captured=1, seen=1, round_trip_ms=2.0) for ms in (9,)]
    result = RtcResult(
        pixels=tuple(pixels),
        receptions=(reception(OURS, 1.0), reception(PEER, 34.0), reception(PEER, 36.0)),
        sessions=(session(NO_LEG, 60.0), session(CUT, 61.0), session(CUT, 65.0, lost=2)),
    )
    found = {(headline.what, headline.who): headline for headline in headlines(result)}
    assert found["capture to pixel, p99", "partner's page"].value == 9
    assert found["picture, sent to decoded, p50", PEER].value == 35
    assert found["uplink_video, capture to display, p99", CUT].value == 63
    assert found["picture to the partner", CUT].value == 1400
    assert ("picture to the partner", NO_LEG) not in found
    lost = "RTP packets lost over the radio"
    assert (found[lost, NO_LEG].met, found[lost, CUT].met) == (True, False)
    assert headlines(RtcResult()) == []
