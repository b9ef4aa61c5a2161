"""The passes after that of a session, so that people can plan them."""

from collections.abc import Iterator

import numpy as np

from kontur_av.errors import ConfigError
from pipelines.seats.texts import PassText
from telepresence.link.radio.orbit import next_overflight, parse_elements
from telepresence.link.radio.profile import RadioProfile

_MOST = 5


def passes_ahead(profile: RadioProfile) -> tuple[PassText, ...]:
    """Return this session's pass and the next four; none of a radio without an orbit."""
    return tuple(_passes(profile))


def _passes(profile: RadioProfile) -> Iterator[PassText]:
    contact = profile.contact
    if contact is None:
        return
    elements = parse_elements(contact.elements)
    station = contact.latitude_deg, contact.longitude_deg, contact.altitude_m
    after, first = contact.after, None
    for _ in range(_MOST):
        try:
            flight = next_overflight(
                elements, station, after, contact.horizon_deg, contact.least_peak_deg
            )
        except ConfigError:
            return
        rise = np.datetime64(flight.rise.removesuffix("Z"), "s")
        first = rise if first is None else first
        acquisition_s = float((rise - first).astype(int))
        yield PassText(
            acquisition=flight.rise,
            acquisition_s=acquisition_s,
            loss_s=round(acquisition_s + flight.visible_s, 1),
            peak_deg=round(max(flight.elevations_deg), 1),
        )
        after = f"{rise + np.timedelta64(round(flight.visible_s) + 60, 's')}Z"
