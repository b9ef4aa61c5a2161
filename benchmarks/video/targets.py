"""The targets of `python -m benchmarks video` that compare with peers. A core."""

from dataclasses import replace

from pipelines.bench.video.quality import ALONE, CAPS, P99, Target

#: Two encoders of GStreamer, and Chromium with two codecs.
DEFAULT, TUNED = "gst-default", "gst-tuned"
CHROMIUM = {"chromium-h264": "H264", "chromium-vp9": "VP9"}


def _any_peer(name: str) -> bool:
    return name in (DEFAULT, TUNED)


def _tuned(name: str) -> bool:
    return name == TUNED


_WORST = "PSNR of the worst 5 %, over the better peer"
#: At 85 kbit/s in a channel of 88.
NARROW = (
    *ALONE,
    Target(
        what="PSNR, over the better peer",
        unit="dB",
        value=lambda found: found.psnr_db.mean,
        bound=1,
        most=False,
        peers=_any_peer,
    ),
    Target(
        what=_WORST,
        unit="dB",
        value=lambda found: found.psnr_db.worst,
        bound=1,
        most=False,
        peers=_any_peer,
    ),
    Target(
        what="CPU of both ends, of the thriftier peer's",
        unit="times",
        value=lambda found: found.cpu_s,
        bound=1.5,
        most=True,
        peers=_any_peer,
        ratio=True,
    ),
)

#: The same on clips that no setting was tuned on.
STRANGE = tuple(
    replace(target, bound=1.5) if target.what == _WORST else target for target in NARROW
)

#: At 512 kbit/s in a channel of 530.
WIDE = (
    P99,
    Target(
        what="PSNR, over the tuned peer",
        unit="dB",
        value=lambda found: found.psnr_db.mean,
        bound=0,
        most=False,
        peers=_tuned,
    ),
    *CAPS,
)
