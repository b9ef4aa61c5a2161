"""The section `sync` of a session's report."""

from kontur_av.clock import NS_PER_MS
from pipelines.report.model import SyncReport
from pipelines.report.sync.figures import SENSES, SyncFigures
from pipelines.session.setup.table import GROUND_MIC, Setup
from telepresence.world import CONTACT_SCENES


def sync_section(setup: Setup, figures: SyncFigures, *, media: bool) -> SyncReport | None:
    """Contacts, and when they were seen, heard and felt; None if nothing was touched.

    media: False if the session had no streams, whatever its setup says.
    """
    carried = {"haptic_up", *(stream.name for stream in setup.streams if media)}
    senses = [
        sense
        for sense, stream in SENSES.items()
        if stream in carried and _touch_reaches(setup, sense)
    ]
    soonest_ns = round(setup.radio_profile.delay_ms * NS_PER_MS)
    return figures.report(senses, soonest_ns=soonest_ns)


def _touch_reaches(setup: Setup, sense: str) -> bool:
    """Whether the operator sees or hears the place where the simulated stylus touches.

    A flash in a film, or a click at the user's own microphone, is no contact.
    """
    inputs = {"light": setup.camera_inputs, "click": (GROUND_MIC,)}.get(sense, ())
    return all(setup.source(name) in CONTACT_SCENES for name in inputs)
