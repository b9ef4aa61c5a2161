"""`python -m benchmarks video`: targets, groups of clips and peers, without processes."""

import numpy as np

from benchmarks.video.bridge import through_the_channel
from benchmarks.video.crops import detail, shot_numbers, side_by_side
from benchmarks.video.groups import group_headlines, group_rows, group_verdicts
from benchmarks.video.packages import PACKAGED, cached, matching
from benchmarks.video.targets import DEFAULT, NARROW, STRANGE, TUNED, WIDE
from pipelines.bench.video.figures import OURS, ContenderFigures, QualityMeans, judge


def figures(**changes) -> ContenderFigures:
    """Figures that meet all targets; what the targets do not ask for is 0."""
    base = dict.fromkeys(ContenderFigures.__dataclass_fields__, 0) | {
        "latency_ms": {"p50": 30.0, "p95": 35.0, "p99": 40.0, "max": 50.0},
        "psnr_db": QualityMeans(30.0, 25.0),
        "ssim": QualityMeans(0.9, 0.8),
        "vmaf": None,
        "per_second": 29.0,
        "longest_gap_ms": 70.0,
        "payload_1s_bps": 85_000.0,
        "payload_100ms_bps": 120_000.0,
        "rtp_1s_bps": 88_000.0,
        "rtp_100ms_bps": 125_000.0,
        "payload_bps": 80_000.0,
        "sender_cpu_s": 1.0,
        "receiver_cpu_s": 1.0,
        "channel_late_us": {"p50": 0.0, "p95": 0.0, "p99": 0.0, "max": 0.0},
        "realtime": True,
    }
    return ContenderFigures(**(base | changes))


def missed(measured, targets=NARROW) -> list[str]:
    return [verdict.what for verdict in judge(measured, targets, 85) if not verdict.met]


def test_relative_targets_compare_with_the_better_peer():
    worse, better = QualityMeans(27.0, 23.9), QualityMeans(28.9, 20.0)
    peers = {DEFAULT: figures(psnr_db=worse), TUNED: figures(psnr_db=better, sender_cpu_s=0.4)}

    def found(targets=NARROW, **changes):
        return missed({OURS: figures(**changes), **peers}, targets)

    assert found() == []
    assert found(sender_cpu_s=1.2) == ["CPU of both ends, of the thriftier peer's"]
    assert len(found(psnr_db=QualityMeans(29.8, 24.8))) == 2
    assert found(payload_1s_bps=85_001.0) == ["largest 1 s window of payload"]
    assert found(WIDE, psnr_db=QualityMeans(28.8, 1.0)) == ["PSNR, over the tuned peer"]
    # Without a peer only absolute targets are judged.
    assert len(judge({OURS: figures()}, NARROW, 85)) == len(NARROW) - 3
    assert judge({TUNED: figures()}, NARROW, 85) == []


def test_the_clips_of_packages_are_named_once_and_verified(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert len({clip.name for clip in PACKAGED}) == len(PACKAGED) >= 3
    path = tmp_path / "kontur-av" / "clips" / PACKAGED[0].file_name
    path.parent.mkdir(parents=True)
    path.write_bytes(b"another file")
    assert cached(PACKAGED[0]) is None


def test_numbered_pictures_of_a_package_are_ordered_by_number():
    names = ["a/image10.pgm", "a/image2.pgm", "a/depth2.bin", "b/image1.pgm"]
    assert matching("a/image*.pgm", names) == ["a/image2.pgm", "a/image10.pgm"]


def test_a_group_takes_its_clips_together():
    sharp = figures(psnr_db=QualityMeans(31.0, 27.0), latency_ms={"p50": 30.0, "p99": 44.0})
    late = figures(psnr_db=QualityMeans(29.0, 25.0), latency_ms={"p50": 32.0, "p99": 46.0})
    peer = figures(psnr_db=QualityMeans(28.5, 24.0))
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


def test_crops_show_the_part_with_detail_and_name_an_older_picture():
    original = np.full((480, 640), 90, np.uint8)
    original[240:, 320:] = np.random.default_rng(1).integers(0, 256, (240, 320), np.uint8)
    assert detail(original) == (240, 320)
    assert shot_numbers(630, 30) == (180, 330, 480)
    sheet = side_by_side(original, {OURS: (7, original), TUNED: (6, 255 - original)}, 7)
    assert sheet.shape == (508, 3 * 640)
    assert (sheet[28::2, 640:1280:2] == original[240:, 320:]).all()
    assert (sheet[28::2, 1280::2] == 255 - original[240:, 320:]).all()


def test_a_description_keeps_no_way_around_the_channel_and_gets_the_rate():
    sdp = "v=0\r\nm=video 9 UDP/TLS/RTP/SAVPF 96\r\nc=IN IP4 0.0.0.0\r\na=fmtp:96 profile-id=0\r\n"
    ways = "a=candidate:1 1 udp 1 10.0.0.1 5000 typ host\r\na=end-of-candidates\r\n"
    lines = through_the_channel(sdp + ways, 85.0).split("\r\n")
    least = "a=fmtp:96 profile-id=0;x-google-min-bitrate=85"
    assert lines[1:] == [*sdp.split("\r\n")[1:3], "b=AS:85", least, ""]
