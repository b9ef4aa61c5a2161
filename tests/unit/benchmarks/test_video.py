"""`python -m benchmarks video`: targets, groups of clips and peers, without processes."""

from benchmarks.video.groups import group_headlines, group_rows, group_verdicts
from benchmarks.video.targets import DEFAULT, NARROW, STRANGE, TUNED, WIDE
from pipelines.bench.video.quality import OURS, ContenderMetrics, QualityMeans, judge


def metrics(**changes) -> ContenderMetrics:
    """Figures that meet all targets; what the targets do not ask for is 0."""
    none = dict.fromkeys(("p50", "p95", "p99", "max"), 0.0)
    latency_ms = {"p50": 30.0, "p95": 35.0, "p99": 40.0, "max": 50.0}
    base = dict.fromkeys(ContenderMetrics.__dataclass_fields__, 0)
    base |= {"latency_ms": latency_ms, "per_second": 29.0, "longest_gap_ms": 70.0}
    base |= {"psnr_db": QualityMeans(30.0, 25.0), "ssim": QualityMeans(0.9, 0.8), "vmaf": None}
    base |= {"payload_1s_bps": 85_000.0, "payload_100ms_bps": 120_000.0, "payload_bps": 80_000.0}
    base |= {"rtp_1s_bps": 88_000.0, "rtp_100ms_bps": 125_000.0, "realtime": True}
    base |= {"sender_cpu_s": 1.0, "receiver_cpu_s": 1.0, "channel_late_us": none}
    return ContenderMetrics(**(base | changes))


def test_relative_targets_compare_with_the_better_peer():
    worse, better = QualityMeans(27.0, 23.9), QualityMeans(28.9, 20.0)
    peers = {DEFAULT: metrics(psnr_db=worse), TUNED: metrics(psnr_db=better, sender_cpu_s=0.4)}

    def found(targets=NARROW, **changes):
        verdicts = judge({OURS: metrics(**changes), **peers}, targets, 85)
        return [verdict.what for verdict in verdicts if not verdict.met]

    assert found() == []
    assert found(sender_cpu_s=1.2) == ["CPU of both ends, of the thriftier peer's"]
    assert len(found(psnr_db=QualityMeans(29.8, 24.8))) == 2
    assert found(payload_1s_bps=85_001.0) == ["largest 1 s window of payload"]
    assert found(WIDE, psnr_db=QualityMeans(28.8, 1.0)) == ["PSNR, over the tuned peer"]
    # Without a peer only absolute targets are judged.
    assert len(judge({OURS: metrics()}, NARROW, 85)) == len(NARROW) - 3
    assert judge({TUNED: metrics()}, NARROW, 85) == []


def test_a_group_takes_its_clips_together():
    sharp = metrics(psnr_db=QualityMeans(31.0, 27.0), latency_ms={"p50": 30.0, "p99": 44.0})
    late = metrics(psnr_db=QualityMeans(29.0, 25.0), latency_ms={"p50": 32.0, "p99": 46.0})
    peer = metrics(psnr_db=QualityMeans(28.5, 24.0))
    clips = {"one": {OURS: sharp, TUNED: peer, "gone": peer}, "two": {OURS: late, TUNED: peer}}
    rows = {row.what: row.values for row in group_rows(list(clips.values()))}
    assert rows["PSNR, mean"] == {OURS: 30.0, TUNED: 28.5}
    assert rows["capture to displayed, p99, worst clip"][OURS] == 46.0
    by_clip = {name: judge(clip, STRANGE, 85) for name, clip in clips.items()}
    found = {verdict.what: verdict for verdict in group_verdicts(by_clip)}
    # A comparison is met by the mean of the clips; a bound holds for each.
    mean = found["PSNR, over the better peer"]
    assert (mean.mean, mean.worst, mean.clip) == (1.5, 0.5, "two")
    assert (mean.met, mean.met_on, mean.clips) == (True, 1, 2)
    worst = found["PSNR of the worst 5 %, over the better peer"]
    assert (worst.target, worst.mean, worst.met_on) == ("≥ 1.5 dB", 2.0, 1)
    latency = found["capture to displayed, p99"]
    assert (latency.worst, latency.clip, latency.met) == (46.0, "two", False)
    headlines = {line.what: line for line in group_headlines("t", [], list(found.values()))}
    assert headlines["capture to displayed, p99, worst clip"].value == 46.0
    assert headlines["PSNR, over the better peer, mean of clips"].value == 1.5
    assert group_rows([]) == []
