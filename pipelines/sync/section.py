"""The section `sync` of a session's report."""

from typing import Any

from kontur_av.clock import NS_PER_MS
from pipelines.setup import Setup
from pipelines.sync.figures import SENSES, SyncFigures


def sync_section(setup: Setup, figures: SyncFigures, *, media: bool) -> dict[str, Any] | None:
    """Contacts, and when they were seen, heard and felt; None if nothing was touched.

    media: without, the session had no streams, whatever its setup says.
    """
    carried = {"haptic_up", *(stream.name for stream in setup.streams if media)}
    senses = [sense for sense, stream in SENSES.items() if stream in carried]
    soonest_ns = round(setup.radio_profile.delay_ms * NS_PER_MS)
    return figures.report(senses, soonest_ns=soonest_ns)
