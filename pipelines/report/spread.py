"""Histograms as rows of the report. A core."""

from kontur_av.clock import NS_PER_MS
from kontur_av.meters import Histogram
from pipelines.report.model import Spread


def spread_ms(histogram: Histogram) -> Spread:
    """Percentiles of values in ns, in ms; to the microsecond, because more would be noise."""
    summary = histogram.summary_ms()
    return Spread(
        p50=round(summary["p50"], 3),
        p95=round(summary["p95"], 3),
        p99=round(summary["p99"], 3),
        p99_9=round(histogram.percentile(99.9) / NS_PER_MS, 3),
        max=round(summary["max"], 3),
        mean=round(histogram.mean / NS_PER_MS, 3),
        count=histogram.count,
    )
