"""What the project wants of latencies, and whether a run did it. A core.

The bounds are those of `spacejustin` on the radio `clean`, on virtual time.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from kontur_av.clock import NS_PER_MS

#: In ms. Force: at p99.9, above what the radio takes; pictures and voice: at p99, the radio's delay
#: included; the skew: at p95.
FORCE_MS, VIDEO_MS, VOICE_MS, SKEW_MS = 3.0, 45.0, 60.0, 45.0
#: Setup and radio for which the bounds are meant.
MEANT_FOR = ("spacejustin", "clean")


@dataclass(frozen=True, slots=True)
class Verdict:
    """One target. bound, found: in words."""

    what: str
    bound: str
    found: str
    met: bool


def judge(report: Mapping[str, Any]) -> list[Verdict]:
    """A verdict on each target for which the report of a run has something."""
    verdicts: list[Verdict | None] = [_force(report)]
    for name, stream in report["streams"].items():
        video = name.endswith("video")
        latency = stream["latency_ms"]
        if latency["count"]:
            bound_ms = VIDEO_MS if video else VOICE_MS
            what = f"{name}, {'capture to display' if video else 'mouth to ear'}, p99"
            verdicts.append(_at_most(what, bound_ms, latency["p99"]))
    skew = report["skew_ms"].get("video_haptic")
    if skew is not None:
        verdicts.append(_at_most("video after force, p95", SKEW_MS, skew["p95"]))
    together = report["lip_sync"]
    if together is not None:
        verdicts.append(
            Verdict(
                "sound -45 to +125 ms after picture (ITU-R BT.1359)",
                "always",
                f"{100 * together['within']:.3f} % of time",
                together["within"] == 1,
            )
        )
    return [verdict for verdict in verdicts if verdict is not None]


def _force(report: Mapping[str, Any]) -> Verdict | None:
    latency = report["haptic"]["up"]["latency_ms"]
    radio = report["gateways"]["ground"].get("radio")
    if radio is None or not latency["count"]:
        return None
    above_ms = latency["p99.9"] - radio["delay_max_ns"] / NS_PER_MS
    return _at_most("force, one way, above the radio's delay, p99.9", FORCE_MS, above_ms)


def _at_most(what: str, bound_ms: float, found_ms: float) -> Verdict:
    return Verdict(what, f"<= {bound_ms:g} ms", f"{found_ms:.1f} ms", found_ms <= bound_ms)
