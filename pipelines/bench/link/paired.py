"""What protection costs, from pairs of runs of two gateways: with it and without. A core."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from statistics import median

from kontur_av.clock import NS_PER_US
from pipelines.report.result import Headline

#: By way: how the path between the gateways is kept.
PLAIN, PROTECTED, REKEYED = "insecure", "protected", "protected, new keys often"
WAYS = (PLAIN, PROTECTED, REKEYED)
#: At most so much may protection add.
MOST_DELAY_US, MOST_CPU_PERCENT, MOST_LATENESS_US = 100.0, 5.0, 20.0

_PERCENTILES = (50.0, 99.0, 99.9)


@dataclass(frozen=True, slots=True, kw_only=True)
class EndFigures:
    """One gateway of a run. cpu_percent: of a core. lateness_us: of its slots, by percentile.

    slips: slots that were left out. sessions: handshakes.
    """

    cpu_percent: float
    lateness_us: Mapping[str, float]
    slips: int
    sessions: int


@dataclass(frozen=True, slots=True, kw_only=True)
class PairedRun:
    """One run. delay_us: of haptic samples, by direction and percentile.

    samples: that arrived. frames_lost: of both directions, once both ends ran.
    """

    way: str
    delay_us: Mapping[str, Mapping[str, float]]
    samples: int
    frames_lost: int
    ends: Mapping[str, EndFigures]


def delays_us(delays_ns: Sequence[int]) -> dict[str, float]:
    """Percentiles by nearest rank, in µs; empty without values."""
    ordered = sorted(delays_ns)
    if not ordered:
        return {}
    return {
        f"p{percent:g}": ordered[max(0, -(-len(ordered) * round(percent * 10) // 1000) - 1)]
        / NS_PER_US
        for percent in _PERCENTILES
    }


def pairs(runs: Sequence[PairedRun], way: str, other: str) -> list[tuple[PairedRun, PairedRun]]:
    """Each run of a way with that of the other way that came after it."""
    first = [run for run in runs if run.way == way]
    second = [run for run in runs if run.way == other]
    return list(zip(first, second, strict=False))


def headlines(runs: Sequence[PairedRun]) -> list[Headline]:
    """Medians over the runs, and what protection adds pair by pair, with its targets."""
    found = []
    for way in WAYS:
        mine = [run for run in runs if run.way == way]
        for direction in ("uplink", "downlink"):
            for name in ("p50", "p99", "p99.9"):
                values = [run.delay_us[direction][name] for run in mine if run.delay_us[direction]]
                found.append(
                    _line(f"haptic sample one way, {direction}, {name}", way, "µs", values)
                )
        for end in ("ground", "space"):
            ends = [run.ends[end] for run in mine]
            found.append(
                _line(f"CPU of the {end} gateway", way, "%", [one.cpu_percent for one in ends])
            )
            for name in ("p99", "p99.9"):
                late = [one.lateness_us[name] for one in ends]
                found.append(_line(f"slots of the {end} gateway late, {name}", way, "µs", late))
            slips = [float(one.slips) for one in ends]
            found.append(_line(f"slots of the {end} gateway left out", way, "", slips))
        found.append(_line("frames lost", way, "", [float(run.frames_lost) for run in mine]))
        sessions = [float(one.sessions) for run in mine for one in run.ends.values()]
        found.append(_line("handshakes of an end", way, "", sessions))
    for direction in ("uplink", "downlink"):
        more = [
            protected.delay_us[direction]["p99"] - plain.delay_us[direction]["p99"]
            for plain, protected in pairs(runs, PLAIN, PROTECTED)
            if plain.delay_us[direction] and protected.delay_us[direction]
        ]
        what = f"added to a sample's way, {direction}, p99"
        found.append(_line(what, "", "µs", more, MOST_DELAY_US))
    for end in ("ground", "space"):
        of_end = [
            (plain.ends[end], protected.ends[end])
            for plain, protected in pairs(runs, PLAIN, PROTECTED)
        ]
        more = [protected.cpu_percent - plain.cpu_percent for plain, protected in of_end]
        what = f"added to the CPU of the {end} gateway"
        found.append(_line(what, "", "%", more, MOST_CPU_PERCENT))
        late = [
            protected.lateness_us["p99"] - plain.lateness_us["p99"] for plain, protected in of_end
        ]
        what = f"added to the lateness of slots of the {end} gateway, p99"
        found.append(_line(what, "", "µs", late, MOST_LATENESS_US))
        # A handshake takes some slots of 2000, so it shows at p99.9 and in slots left out.
        renewed = [
            (kept.ends[end], often.ends[end]) for kept, often in pairs(runs, PROTECTED, REKEYED)
        ]
        late = [often.lateness_us["p99.9"] - kept.lateness_us["p99.9"] for kept, often in renewed]
        what = f"added by new keys to the lateness of slots of the {end} gateway, p99.9"
        found.append(_line(what, "", "µs", late))
        slips = [float(often.slips - kept.slips) for kept, often in renewed]
        what = f"added by new keys to the slots of the {end} gateway left out"
        found.append(_line(what, "", "", slips))
    return found


def _line(
    what: str, who: str, unit: str, values: Sequence[float], most: float | None = None
) -> Headline:
    """The median. most: a target for what protection adds."""
    value = median(values) if values else None
    if most is None:
        return Headline(group="protection, medians", what=what, who=who, unit=unit, value=value)
    return Headline(
        group="what protection adds, median of pairs",
        what=what,
        unit=unit,
        value=value,
        target=f"at most {most:g}",
        met=None if value is None else value <= most,
    )
