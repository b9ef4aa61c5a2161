"""Whether stamps and content agree, judged from few instants of which some are inexact.

A click in a loud vowel, or a light half behind the arm, may be dated wrongly by several
milliseconds or by a whole picture. So only the clearest findings are judged, by the interval in
which their median lies with 95 % confidence (order statistics: David and Nagaraja, Order
Statistics, 3rd edition, 7.1). The fewer they are, the wider is that interval.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from kontur_av.clock import NS_PER_MS
from pipelines.report.sync.matching import Matched

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
class SyncVerdict:
    """What the clearest findings say of the stamps.

    judged: their number. median_ns: the median of stamp minus instant of the contact. between_ns:
    where that median lies with 95 % confidence. allowed_ns: where it may lie. agrees: None if the
    findings are too few, or allow both answers.
    """

    judged: int
    median_ns: int | None
    between_ns: tuple[int, int] | None
    allowed_ns: tuple[int, int]
    agrees: bool | None


def judge(perceived: Sequence[tuple[int, Matched]]) -> SyncVerdict:
    """The verdict on pairs of a contact's instant and its finding; without a stamp: left out."""
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
    if len(errors) >= LEAST_VERDICT:
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
