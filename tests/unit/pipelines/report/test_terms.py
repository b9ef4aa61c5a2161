"""The terms of the lead of force over its picture are correct and add up."""

from dataclasses import replace
from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from kontur_av.clock import NS_PER_MS, NS_PER_S
from pipelines.report.model import Terms
from pipelines.report.terms import TERMS, DelaySums, video_lead, zone_bps
from pipelines.session.setup.setup_file import BUILT_IN
from telepresence.link.link_metrics import SenderMetrics
from telepresence.link.profile import UPLINK
from telepresence.link.radio import load_radio

SETUP = replace(BUILT_IN["spacejustin"], radio="clean")
FORCE_NS = 11 * NS_PER_MS


def uplink(samples=1000, frames=1000, header_octets=0, packets=1):
    sent = SenderMetrics(
        frames=frames,
        octets={"haptic": 12 * samples},
        headers={"uplink_video": {"header_octets": header_octets, "packets": packets}},
    )
    return SimpleNamespace(sender=sent)


def instants(*steps_ms, at_ms=0):
    """Captured, at the encoder, begun, encoded, received, decoded, displayed."""
    found = [at_ms * NS_PER_MS]
    for step_ms in steps_ms:
        found.append(found[-1] + round(step_ms * NS_PER_MS))
    return tuple(found)


def lead_of(way, link=None, setup=SETUP, **more):
    return video_lead(setup, way, link or uplink(), force_ns=FORCE_NS, epoch_ns=0, **more)


def test_each_term_equals_its_input_and_a_picture_has_the_weight_of_its_time():
    way = DelaySums()
    # 240 octets take 20 slots of 12. Of the network's 35 ms the radio takes 10, so 5 are queueing.
    way.add(instants(4, 1, 6, 35, 3, 0.5), 40 * NS_PER_MS, (240, 1))
    lead = lead_of(way)
    found = {"camera": 20.0, "capture": 4.0, "encoding": 6.0, "queueing": 6.0, "decoding": 3.0}
    found |= {"serialisation": 20.0, "propagation": 10.0, "display": 0.5, "total": 69.5}
    assert lead.video_ms == Terms(**found)
    assert lead.force_ms.queueing == 1.0
    assert lead.lead_ms.propagation == 0.0
    assert lead.lead_ms.total == 58.5
    # Past gateways and radio, all of the network's time is queueing.
    past = lead_of(way, bypass=True)
    assert past.video_ms.queueing == 36.0 and past.force_ms.queueing == 11.0
    assert past.video_ms.serialisation == past.video_ms.propagation == 0.0
    way = DelaySums()
    way.add(instants(0, 0, 0, 50, 0, 0), 30 * NS_PER_MS, (0, 1))
    way.add(instants(0, 0, 0, 80, 0, 0), 60 * NS_PER_MS, (0, 1))
    lead = lead_of(way)
    assert lead.video_ms.camera == pytest.approx((30 * 15 + 60 * 30) / 90, abs=1e-3)
    assert lead.video_ms.total == pytest.approx((30 * 65 + 60 * 110) / 90, abs=1e-3)
    assert zone_bps(UPLINK, uplink()) == 96_000
    assert zone_bps(UPLINK, uplink(samples=0)) == 192_000
    way = DelaySums()
    way.add(instants(0, 0, 0, 60, 0, 0), 30 * NS_PER_MS, (234, 2))
    assert lead_of(way, uplink(header_octets=9, packets=3)).video_ms.serialisation == 20.0
    assert lead_of(way, uplink(0, header_octets=9, packets=3)).video_ms.serialisation == 10.0


@given(
    st.lists(
        st.tuples(
            st.lists(st.floats(0, 200), min_size=6, max_size=6),
            st.floats(0.01, 1000),
            st.integers(1, 5000),
            st.integers(1, 6),
        ),
        min_size=1,
        max_size=20,
    ),
    st.integers(0, 1000),
)
def test_the_terms_add_up_for_any_pictures(pictures, samples):
    way = DelaySums()
    for steps_ms, gap_ms, octets, packets in pictures:
        way.add(instants(*steps_ms), round(gap_ms * NS_PER_MS), (octets, packets))
    lead = lead_of(way, uplink(samples=samples, header_octets=3))
    assert lead.video_ms.queueing >= 0
    for terms in (lead.video_ms, lead.force_ms, lead.lead_ms):
        parts = sum(getattr(terms, name) for name in TERMS)
        assert parts == pytest.approx(terms.total, abs=0.0005 * (len(TERMS) + 1) + 1e-6)
    assert lead.video_ms.total - FORCE_NS / NS_PER_MS == pytest.approx(
        lead.lead_ms.total, abs=0.0011
    )


def test_propagation_is_taken_at_the_instants_of_sending(tmp_path):
    radio = tmp_path / "far.toml"
    radio.write_text("delay_ms = 100\ndelay_swing_ms = 50\ndelay_period_s = 40\n")
    setup = replace(SETUP, radio=load_radio(str(radio)))
    epoch_ns = 7 * NS_PER_S
    for second, expected_ms in ((10, 150), (30, 50)):
        way = DelaySums()
        begin_ms = (7 + second) * 1000 - 1
        way.add(instants(0, 0, 1, 500, 0, 0, at_ms=begin_ms), 30 * NS_PER_MS, (0, 1))
        found = way.propagation_ns(setup, setup.uplink, epoch_ns)
        assert found / NS_PER_MS == pytest.approx(expected_ms, abs=1)
