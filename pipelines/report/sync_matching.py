"""Assigns the lights, clicks and steps that were found to their contacts, and judges stamps.

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
#: A finding farther than this from the usual delay is believed only if it is strong; findings whose
#: stamps spread wider give no verdict.
_NEAR_NS = 120 * NS_PER_MS
#: The least strength of a near and of a far finding, relative to the median of the near ones.
_LEAST_NEAR, _LEAST_FAR = 0.2, 0.6
#: The largest median error of stamps of sound and touch. A picture may also be dated later, by up
#: to the time since the picture before.
TOLERANCE_NS = 2 * NS_PER_MS
#: A verdict needs at least this many findings.
LEAST_VERDICT = 4
#: The stronger half is judged, but at least this many; all of them, if none is stronger.
_LEAST_CLEAR = 6
#: The median lies below the interval with a probability of one in this many; also above it.
_ONE_IN = 40


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


@dataclass(frozen=True, slots=True)
class SyncVerdict:
    """What the clearest findings say of the stamps.

    judged: their number. median_ns: the median of stamp minus instant of the contact. between_ns:
    where that median lies with 95 % confidence. allowed_ns: where it may lie. agrees: None if the
    findings are too few, spread too wide, or allow both answers.
    """

    judged: int
    median_ns: int | None
    between_ns: tuple[int, int] | None
    allowed_ns: tuple[int, int]
    agrees: bool | None


def judge(perceived: Sequence[tuple[int, Matched]]) -> SyncVerdict:
    """The verdict on pairs of a contact's instant and its finding; without a stamp: left out.

    A click in a loud vowel, or a light half behind the arm, may be dated wrongly by several
    milliseconds or by a whole picture. So only the clearest findings are judged, by the interval in
    which their median lies with 95 % confidence (order statistics: David and Nagaraja, Order
    Statistics, 3rd edition, 7.1). The fewer they are, the wider is that interval.
    """
    stamped = [
        (found.strength, found.stamp_ns - contact_ns, found.slack_ns)
        for contact_ns, found in perceived
        if found.stamp_ns is not None
    ]
    stamped.sort(key=lambda one: -one[0])
    clearest = stamped[: max(_LEAST_CLEAR, (len(stamped) + 1) // 2)]
    if stamped and stamped[0][0] == stamped[-1][0]:
        # None is clearer, as with steps of the force. Half of them would just be the earlier half.
        clearest = stamped
    if not clearest:
        return SyncVerdict(0, None, None, (-TOLERANCE_NS, TOLERANCE_NS), None)
    errors = sorted(error_ns for _, error_ns, _ in clearest)
    slack = sorted(slack_ns for _, _, slack_ns in clearest)
    middle = (len(errors) - 1) // 2
    allowed = -TOLERANCE_NS, TOLERANCE_NS + slack[middle]
    between = median_interval(errors)
    agrees = None
    # Mistaken findings all come after their contact. They are told by their spread.
    if len(errors) >= LEAST_VERDICT and between[1] - between[0] <= _NEAR_NS:
        if between[1] < allowed[0] or between[0] > allowed[1]:
            agrees = False
        elif allowed[0] <= errors[middle] <= allowed[1]:
            agrees = True
    return SyncVerdict(len(errors), errors[middle], between, allowed, agrees)


def median_interval(ordered: Sequence[int]) -> tuple[int, int]:
    """The interval in which the median of the distribution lies with 95 % confidence.

    ordered: ascending values drawn from it. With fewer than nine the interval is all that they
    span; with fewer than six its confidence is lower.
    """
    count = len(ordered)
    left_out, ways, below, every = 0, 1, 1, 2**count
    # Leave out values at both ends while it is unlikely that all of them lie on one side.
    while _ONE_IN * below <= every:
        ways = ways * (count - left_out) // (left_out + 1)
        below += ways
        left_out += 1
    left_out = max(0, left_out - 1)
    return ordered[left_out], ordered[count - 1 - left_out]
