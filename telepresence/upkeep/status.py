"""What a program tells to whom runs it: one small JSON file, replaced twice a second or so. A core.

`{"contact": true, "passed": false, "stuck": false}`, as of `VersionStatus`. Any program can write
it: the path stands in the environment variable `KONTUR_AV_STATUS`.
"""

import msgspec

from telepresence.link.figures import SupervisionFigures
from telepresence.link.supervision.message import LinkState
from telepresence.malformed import MALFORMED
from telepresence.upkeep.version_stack import VersionStatus

VARIABLE = "KONTUR_AV_STATUS"
_APPROVE, _CONNECTED, _REFUSED = (
    state.name.lower() for state in (LinkState.APPROVE, LinkState.CONNECTED, LinkState.REFUSED)
)


def status_of(figures: SupervisionFigures) -> VersionStatus:
    """Return what a gateway tells. Ends that agree on flows and frames pass their data."""
    # A peer that is refused has been heard, though its frames may not count as a signal.
    contact = figures.signal or figures.state == _REFUSED
    return VersionStatus(
        contact=contact,
        passed=figures.state == _CONNECTED,
        stuck=contact and figures.state not in (_APPROVE, _CONNECTED),
    )


def pack_status(status: VersionStatus) -> bytes:
    return msgspec.json.encode(status) + b"\n"


def parse_status(octets: bytes) -> VersionStatus | None:
    """Return what a program has told; None for any other text."""
    try:
        return msgspec.json.decode(octets, type=VersionStatus)
    except MALFORMED:
        return None
