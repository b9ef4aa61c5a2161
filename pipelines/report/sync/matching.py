"""Assigns the lights, clicks and steps that were found to their contacts.

A sense has nearly the same delay at every contact. So the findings vote on that delay. A plosive of
a voice, or an arm that comes into view, may be mistaken for a click or a light; it loses the vote,
because its delay is another one each time. Stamps are not used.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from kontur_av.clock import NS_PER_MS

#: A contact is seen, heard or felt within this time.
LATEST_NS = 1500 * NS_PER_MS
#: Votes are counted in boxes of this width; this many neighbours on either side count as well.
_BOX_NS = 10 * NS_PER_MS
_NEIGHBOURS = 7
#: A finding farther than this from the usual delay is believed only if it is strong.
_NEAR_NS = 120 * NS_PER_MS
#: The least strength of a near and of a far finding, relative to the median of the near ones.
_LEAST_NEAR, _LEAST_FAR = 0.2, 0.6


@dataclass(frozen=True, slots=True)
class Matched:
    """Something that a detector found.

    instant_ns: when it was shown, heard or felt. strength: the detector's own measure. stamp_ns:
    when it happened by the stamps that travelled with it; None if unknown. slack_ns: how much
    earlier it may have happened: a camera sees a light only in its next picture.
    """

    instant_ns: int
    strength: float = 1.0
    stamp_ns: int | None = None
    slack_ns: int = 0


def match(
    contacts: Sequence[int], found: Sequence[Matched], *, soonest_ns: int = 0
) -> list[Matched | None]:
    """What was found of each contact (instants in ns, ascending), or None.

    found: ascending by instant. soonest_ns: the least delay. Each finding is used once. If it comes
    when the next contact may already be perceived, it belongs to that one.
    """
    begins = [contact_ns + soonest_ns for contact_ns in contacts]
    ends = [begin_ns + LATEST_NS for begin_ns in begins]
    for index, next_ns in enumerate(begins[1:]):
        ends[index] = min(ends[index], next_ns)
    return _chosen(contacts, found, begins, ends)


def match_around(
    contacts: Sequence[int], found: Sequence[Matched], *, around_ns: int
) -> list[Matched | None]:
    """As `match`, but a finding may also come before its contact, by at most `around_ns`.

    Each finding is used once. Between two contacts it belongs to the nearer one.
    """
    begins = [contact_ns - around_ns for contact_ns in contacts]
    ends = [contact_ns + around_ns for contact_ns in contacts]
    for index, (one_ns, next_ns) in enumerate(pairwise(contacts)):
        halfway_ns = (one_ns + next_ns) // 2
        ends[index] = min(ends[index], halfway_ns)
        begins[index + 1] = max(begins[index + 1], halfway_ns)
    return _chosen(contacts, found, begins, ends)


def _chosen(
    contacts: Sequence[int], found: Sequence[Matched], begins: Sequence[int], ends: Sequence[int]
) -> list[Matched | None]:
    """The finding of each contact, out of those from its begin to before its end."""
    instants = np.array([one.instant_ns for one in found], np.int64)
    candidates = [
        found[first:last]
        for first, last in zip(
            np.searchsorted(instants, begins), np.searchsorted(instants, ends), strict=True
        )
    ]
    usual_ns = _usual(contacts, candidates)

    def near(contact_ns: int, one: Matched) -> bool:
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


def _usual(contacts: Sequence[int], candidates: Sequence[Sequence[Matched]]) -> int:
    """The delay (ns) for which most of the findings vote."""
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
