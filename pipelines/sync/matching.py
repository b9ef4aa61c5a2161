"""Which of the lights, clicks and steps that were found belongs to which contact.

A sense is late by nearly the same time at every contact, whatever that time is: what was found is
put to the vote. So a plosive of a voice or an arm that came into view, now and then taken for the
click or the light, does not take their place. Stamps have no say in it.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from kontur_av.clock import NS_PER_MS

#: No later than this after a contact it is seen, heard or felt.
LATEST_NS = 1500 * NS_PER_MS
#: Votes are counted in boxes of this width, and so many neighbours on either side.
_BOX_NS = 10 * NS_PER_MS
_NEIGHBOURS = 7
#: What lies farther than this from what most say is believed only if it is strong.
_NEAR_NS = 120 * NS_PER_MS
#: Of the median strength of those that are near: what the near ones and the far ones must have.
_LEAST_NEAR, _LEAST_FAR = 0.2, 0.6


@dataclass(frozen=True, slots=True)
class Found:
    """Something that a detector found.

    instant_ns: when it was shown, heard or felt. strength: the detector's own measure. stamp_ns:
    when it happened by the stamps that travelled with it, None if they don't tell. slack_ns: how
    much earlier it may have happened: a camera sees a light at its next picture only.
    """

    instant_ns: int
    strength: float = 1.0
    stamp_ns: int | None = None
    slack_ns: int = 0


def match(
    contacts: Sequence[int], found: Sequence[Found], *, soonest_ns: int = 0
) -> list[Found | None]:
    """For each contact (instants in ns, ascending) what was found of it, or None.

    found: ascending by instant. soonest_ns: it takes at least so long. Nothing is used twice: what
    comes when the next contact may be perceived already belongs to that one.
    """
    instants = np.array([one.instant_ns for one in found], np.int64)
    candidates: list[list[Found]] = []
    for index, contact_ns in enumerate(contacts):
        end_ns = contact_ns + LATEST_NS + soonest_ns
        if index + 1 < len(contacts):
            end_ns = min(end_ns, contacts[index + 1] + soonest_ns)
        first, last = np.searchsorted(instants, (contact_ns + soonest_ns, end_ns))
        candidates.append(list(found[first:last]))
    usual_ns = _usual(contacts, candidates)

    def near(contact_ns: int, one: Found) -> bool:
        return abs(one.instant_ns - contact_ns - usual_ns) <= _NEAR_NS

    chosen = []
    for contact_ns, some in zip(contacts, candidates, strict=True):
        close = [one for one in some if near(contact_ns, one)]
        chosen.append(max(close or some, key=lambda one: one.strength, default=None))
    strengths = [
        one.strength
        for contact_ns, one in zip(contacts, chosen, strict=True)
        if one is not None and near(contact_ns, one)
    ]
    typical = float(np.median(strengths)) if strengths else 0.0
    return [
        one
        if one is not None
        and one.strength >= typical * (_LEAST_NEAR if near(contact_ns, one) else _LEAST_FAR)
        else None
        for contact_ns, one in zip(contacts, chosen, strict=True)
    ]


def _usual(contacts: Sequence[int], candidates: Sequence[Sequence[Found]]) -> int:
    """How late most of them say that the sense is (ns)."""
    delays, votes = [], []
    for contact_ns, some in zip(contacts, candidates, strict=True):
        strongest = max((one.strength for one in some), default=1.0)
        for one in some:
            delays.append(one.instant_ns - contact_ns)
            votes.append(one.strength / max(strongest, 1e-12))
    if not delays:
        return 0
    boxes = np.array(delays) // _BOX_NS
    lowest = int(boxes.min())
    counted = np.bincount(boxes - lowest, weights=votes)
    spread = np.convolve(counted, np.bartlett(2 * _NEIGHBOURS + 3)[1:-1])
    return (lowest + int(spread.argmax()) - _NEIGHBOURS) * _BOX_NS + _BOX_NS // 2
