"""Whether stamps and content agree, from few instants of which some are smeared.

A click in a loud vowel, a light half behind the arm: what is left of them may be dated wrongly by
several milliseconds, or a whole picture. So the clearest are judged, and by the interval in which
their median lies with 95 % confidence (order statistics: David and Nagaraja, Order Statistics, 3rd
edition, 7.1): the fewer there are the wider it is.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from kontur_av.clock import NS_PER_MS
from pipelines.report.sync.matching import Found

#: How far the stamps may lie beside what is shown, in the median: sound and touch. A picture may
#: be dated later by up to the time since the one before, and this.
TOLERANCE_NS = 2 * NS_PER_MS
#: From so many on there is a verdict.
LEAST_VERDICT = 4
#: The stronger half is judged, but so many if there are; all, if none is stronger.
_LEAST_CLEAR = 6
#: One in so many: how unlikely it is that the median lies below the interval, or above.
_ONE_IN = 40


@dataclass(frozen=True, slots=True)
class SyncVerdict:
    """What the clearest say of the stamps.

    judged: how many they are. median_ns: of the stamps less the instants of the contacts;
    between_ns: where it lies with 95 % confidence; allowed_ns: where it is explained. agrees: None
    if they are too few, or say neither.
    """

    judged: int
    median_ns: int | None
    between_ns: tuple[int, int] | None
    allowed_ns: tuple[int, int]
    agrees: bool | None


def judge(perceived: Sequence[tuple[int, Found]]) -> SyncVerdict:
    """A verdict from (instant of the contact, what was found of it); without stamp: left out."""
    stamped = [
        (found.strength, found.stamp_ns - contact_ns, found.slack_ns)
        for contact_ns, found in perceived
        if found.stamp_ns is not None
    ]
    stamped.sort(key=lambda one: -one[0])
    clearest = stamped[: max(_LEAST_CLEAR, (len(stamped) + 1) // 2)]
    if stamped and stamped[0][0] == stamped[-1][0]:
        # None is clearer, as with steps of the force: half of them would be the earlier half.
        clearest = stamped
    if not clearest:
        return SyncVerdict(0, None, None, (-TOLERANCE_NS, TOLERANCE_NS), None)
    errors = sorted(error_ns for _, error_ns, _ in clearest)
    slack = sorted(slack_ns for _, _, slack_ns in clearest)
    middle = (len(errors) - 1) // 2
    allowed = -TOLERANCE_NS, TOLERANCE_NS + slack[middle]
    between = median_interval(errors)
    agrees = None
    if len(errors) >= LEAST_VERDICT:
        if between[1] < allowed[0] or between[0] > allowed[1]:
            agrees = False
        elif allowed[0] <= errors[middle] <= allowed[1]:
            agrees = True
    return SyncVerdict(len(errors), errors[middle], between, allowed, agrees)


def median_interval(ordered: Sequence[int]) -> tuple[int, int]:
    """Where the median lies of what ascending values were drawn from, with 95 % confidence.

    Of fewer than nine it is all that they span; of fewer than six that is less certain.
    """
    count = len(ordered)
    left_out, ways, below, every = 0, 1, 1, 2**count
    # So many are left out at either end as are unlikely to lie all on one side of the median.
    while _ONE_IN * below <= every:
        ways = ways * (count - left_out) // (left_out + 1)
        below += ways
        left_out += 1
    left_out = max(0, left_out - 1)
    return ordered[left_out], ordered[count - 1 - left_out]
