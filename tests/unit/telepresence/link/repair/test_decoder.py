"""Requirement: as many repair zones as lost slots restore them; a wrong frame restores nothing."""

from random import Random

import pytest
from common import first_seed, repeats

from telepresence.link.frame import Pointers
from telepresence.link.profile import DOWNLINK, UPLINK
from telepresence.link.repair.codes import WINDOW, CauchyCode, combine, inverse
from telepresence.link.repair.decoder import RepairDecoder
from telepresence.link.repair.encoder import Idle, RepairEncoder


def multiply(a, b):
    return combine([b * (a >> bit & 1) for bit in range(10)])


def test_the_field_of_the_short_code():
    assert [multiply(2, 512), multiply(1, 77), multiply(0, 5)] == [0x409 ^ 1024, 77, 0]
    assert all(multiply(a, inverse(a)) == 1 for a in range(1, 1024))
    # 1 / 512 and 1 / 513.
    assert [CauchyCode().coefficient(9, slot) for slot in (9, 8)] == [inverse(512), inverse(513)]
    code = CauchyCode()
    assert code.sum([(8, code.prepare(1)), (7, code.prepare(1 << 99))], 9) == (
        multiply(512, code.coefficient(9, 7)) << 90 | code.coefficient(9, 8)
    )


@pytest.mark.parametrize("profile", [UPLINK, DOWNLINK], ids=lambda profile: profile.name)
def test_lost_slots_are_restored(profile):
    random = Random(first_seed(5))
    for _ in range(repeats(60)):
        encoder, decoder = RepairEncoder(profile), RepairDecoder(profile)
        size, goes_on = profile.packet_zone_octets, Pointers(profile).no_start
        lost = set(random.sample(range(WINDOW, 2 * WINDOW - 12), random.randint(1, 8)))
        sent = {}
        for count in range(2 * WINDOW):
            zone = random.randbytes(size)
            sent[count] = random.choice((0, 3, goes_on, size - 1)), zone
            if count >= 2 * WINDOW - 12:
                # A code without a Cauchy matrix needs some more than lost slots.
                if profile is UPLINK and count >= 2 * WINDOW - 12 + len(lost):
                    break
                repaired = encoder.repair(count, plain=False, reserved=True)
                restored = decoder.handle_zone(count, *repaired)
                for slot, content in restored:
                    assert content == sent[slot]
                    lost.remove(slot)
            else:
                encoder.protect(count, *sent[count])
                if count in lost:
                    decoder.handle_lost(count)
                else:
                    assert decoder.handle_zone(count, *sent[count]) == []
        assert not lost and not decoder.lost and not decoder.contradictions


def test_without_traffic_the_link_stays_idle():
    for idle, zones in ((Idle.MANY, 4), (Idle.FEW, 2), (Idle.NONE, 0)):
        encoder = RepairEncoder(UPLINK)
        encoder.set_idle(idle)
        assert encoder.repair(7, plain=False) is None
        encoder.protect(8, 0, bytes(12))
        sent = [encoder.repair(count, plain=False) is not None for count in range(9, 2 * WINDOW)]
        assert sum(sent) == zones and all(sent[:zones])


def test_a_wrong_frame_restores_nothing_more():
    encoder, decoder = RepairEncoder(UPLINK), RepairDecoder(UPLINK)
    for count in range(WINDOW + 1):
        encoder.protect(count, 0, count.to_bytes(12, "big"))
        if count == WINDOW:
            decoder.handle_lost(count)
        else:
            decoder.handle_zone(count, 0, (count ^ (count == 9)).to_bytes(12, "big"))
    slots = range(WINDOW + 1, WINDOW + 5)
    restored = [decoder.handle_zone(c, *encoder.repair(c, plain=False)) for c in slots]
    assert restored[0] and not any(restored[1:])
