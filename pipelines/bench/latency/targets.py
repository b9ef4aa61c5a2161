"""The targets of latencies, and whether a run reached them. A core.

The bounds hold for `spacejustin` on the radio `clean`, on virtual time.
"""

from dataclasses import dataclass

from kontur_av.clock import NS_PER_MS
from pipelines.report.model import SessionReport
from pipelines.report.result import Headline

#: In ms. Force: p99.9, above the delay of the radio. Pictures and voice: p99, the delay of the
#: radio included. Skew: p95.
FORCE_MS, VIDEO_MS, VOICE_MS, SKEW_MS = 3.0, 45.0, 60.0, 45.0
#: Setup and radio for which the bounds are meant.
MEANT_FOR = ("spacejustin", "clean")


@dataclass(frozen=True, slots=True)
class LatencyVerdict:
    """One target. bound, found: in words. value: what was found, in `unit`."""

    what: str
    bound: str
    found: str
    met: bool
    unit: str
    value: float

    def headline(self, kind: str, *, judged: bool) -> Headline:
        """As a figure of a `kind` of session. judged: whether the target is meant for it."""
        return Headline(
            what=self.what,
            who=kind,
            unit=self.unit,
            value=self.value,
            target=self.bound if judged else "",
            met=self.met if judged else None,
        )


def judge(report: SessionReport) -> list[LatencyVerdict]:
    """A verdict on each target of which the report of a run has a figure."""
    verdicts = []
    force, radio = report.haptic["up"].latency_ms, report.gateways["ground"].radio
    if radio is not None and force.count:
        above_ms = force.p99_9 - radio.delay_max_ns / NS_PER_MS
        what = "force, one way, above the radio's delay, p99.9"
        verdicts.append(_at_most(what, FORCE_MS, above_ms))
    for name, stream in report.streams.items():
        video = name.endswith("video")
        if stream.latency_ms.count:
            bound_ms = VIDEO_MS if video else VOICE_MS
            what = f"{name}, {'capture to display' if video else 'mouth to ear'}, p99"
            verdicts.append(_at_most(what, bound_ms, stream.latency_ms.p99))
    skew = report.skew_ms.get("video_haptic")
    if skew is not None:
        verdicts.append(_at_most("video after force, p95", SKEW_MS, skew.p95))
    if report.lip_sync is not None:
        within = report.lip_sync.within
        verdicts.append(
            LatencyVerdict(
                "sound -45 to +125 ms after picture (ITU-R BT.1359)",
                "always",
                f"{100 * within:.3f} % of time",
                within == 1,
                "% of time",
                100 * within,
            )
        )
    return verdicts


def _at_most(what: str, bound_ms: float, found_ms: float) -> LatencyVerdict:
    met = found_ms <= bound_ms
    return LatencyVerdict(what, f"<= {bound_ms:g} ms", f"{found_ms:.1f} ms", met, "ms", found_ms)
