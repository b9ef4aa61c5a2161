"""The targets of `bench video`, whether a run reached them. A core."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from pipelines.bench.video.figures import ContenderFigures
from pipelines.report.result import Headline

#: The contender of this project.
OURS = "kontur-av"
#: From the figures of a contender to the value that counts.
Value = Callable[[ContenderFigures], float]


@dataclass(frozen=True, slots=True)
class VideoVerdict:
    """One target. target, found, against: in words; against: what the best peer reached.

    value: what was found, in `unit`. bound: the target in numbers.
    most: whether it is the largest value allowed. relative: whether it compares with a peer.
    """

    what: str
    target: str
    found: str
    against: str
    met: bool
    unit: str
    value: float
    bound: float
    most: bool
    relative: bool


@dataclass(frozen=True, slots=True)
class Target:
    """A bound for `value` of kontur-av; a relative target compares with the best peer.

    most: whether the bound is the largest value allowed; otherwise it is the smallest.
    peers: the peers of a relative target; None for an absolute bound. ratio: compare by division,
    otherwise by difference. of_cap: `value` in per cent of the cap.
    """

    what: str
    unit: str
    value: Value
    bound: float
    most: bool = True
    peers: Callable[[str], bool] | None = None
    ratio: bool = False
    of_cap: bool = False


P99 = Target("capture to displayed, p99", "ms", lambda found: found.latency_ms["p99"], 45)
_SECOND, _TENTH = "largest 1 s window of payload", "largest 0.1 s window of payload"
CAPS = (
    Target(_SECOND, "% of the cap", lambda found: found.payload_1s_bps, 100, of_cap=True),
    Target(_TENTH, "% of its share", lambda found: found.payload_100ms_bps, 150, of_cap=True),
)
#: Of this project alone, at 85 kbit/s in a channel of 88.
ALONE = (
    Target("capture to displayed, p50", "ms", lambda found: found.latency_ms["p50"], 35),
    P99,
    Target("displayed", "/s", lambda found: found.per_second, 28, most=False),
    Target("longest gap", "ms", lambda found: found.longest_gap_ms, 100),
    *CAPS,
)


def judge(
    measured: Mapping[str, ContenderFigures], targets: Sequence[Target], cap_kbps: float
) -> list[VideoVerdict]:
    """A verdict on each target that can be judged; a relative target needs a peer."""
    if OURS not in measured:
        return []
    found = [_verdict(target, measured, cap_kbps) for target in targets]
    return [verdict for verdict in found if verdict is not None]


def _verdict(
    target: Target, measured: Mapping[str, ContenderFigures], cap_kbps: float
) -> VideoVerdict | None:
    value = target.value(measured[OURS])
    against = ""
    if target.of_cap:
        value /= 10 * cap_kbps
    if target.peers is not None:
        others = {
            name: target.value(found) for name, found in measured.items() if target.peers(name)
        }
        if not others:
            return None
        best = (min if target.most else max)(others, key=others.__getitem__)
        against = f"{best} {others[best]:.2f}"
        value = value / others[best] if target.ratio else value - others[best]
    met = value <= target.bound if target.most else value >= target.bound
    sign = "≤" if target.most else "≥"
    return VideoVerdict(
        target.what,
        f"{sign} {target.bound:g} {target.unit}",
        f"{value:.2f} {target.unit}",
        against,
        met,
        target.unit,
        value,
        target.bound,
        target.most,
        target.peers is not None,
    )


#: A figure of a contender: what, its unit, and its value.
_FIGURES: tuple[tuple[str, str, Callable[[ContenderFigures], float | None]], ...] = (
    *(
        (f"capture to displayed, {key}", "ms", lambda found, key=key: found.latency_ms[key])
        for key in ("p50", "p95", "p99", "max")
    ),
    ("PSNR, mean", "dB", lambda found: found.psnr_db.mean),
    ("PSNR, worst 5 %", "dB", lambda found: found.psnr_db.worst),
    ("SSIM, mean", "", lambda found: found.ssim.mean),
    ("SSIM, worst 5 %", "", lambda found: found.ssim.worst),
    ("VMAF, mean", "", lambda found: found.vmaf.mean if found.vmaf else None),
    ("VMAF, worst 5 %", "", lambda found: found.vmaf.worst if found.vmaf else None),
    ("displayed", "pictures/s", lambda found: found.per_second),
    ("longest gap", "ms", lambda found: found.longest_gap_ms),
    ("payload, mean", "kbit/s", lambda found: found.payload_bps / 1000),
    ("largest 1 s of payload", "kbit/s", lambda found: found.payload_1s_bps / 1000),
    ("largest 1 s with RTP headers", "kbit/s", lambda found: found.rtp_1s_bps / 1000),
    ("largest 0.1 s of payload", "kbit/s", lambda found: found.payload_100ms_bps / 1000),
    ("largest 0.1 s with RTP headers", "kbit/s", lambda found: found.rtp_100ms_bps / 1000),
    ("CPU of the sender", "s", lambda found: found.sender_cpu_s),
    ("CPU of the receiver", "s", lambda found: found.receiver_cpu_s),
    ("CPU of both ends", "s", lambda found: found.cpu_s),
)


def notes(name: str, found: ContenderFigures) -> list[str]:
    said = []
    if found.guessed or found.unreadable:
        said.append(
            f"{name}: {found.guessed} numbers known only from their neighbours, "
            f"{found.unreadable} not at all"
        )
    if found.left_out_by_camera:
        said.append(
            f"{name}: {found.left_out_by_camera} pictures left out by the camera, "
            "because the sender had not read the ones before"
        )
    if found.others_cores > 0.1:
        said.append(
            f"{name}: other programs used {found.others_cores:.1f} cores: "
            "an idle machine has lower latencies and higher rates"
        )
    if not found.realtime or found.camera_latest_us > 1000 or found.channel_late_us["p99"] > 500:
        said.append(
            f"{name}: this machine was busy: camera up to {found.camera_latest_us / 1000:.1f} ms "
            f"late, channel {found.channel_late_us['p99'] / 1000:.2f} ms at p99"
            + ("" if found.realtime else ", without real-time priority")
        )
    return said


def headlines(
    group: str, measured: Mapping[str, ContenderFigures], verdicts: Sequence[VideoVerdict]
) -> list[Headline]:
    """Of one clip at one rate."""
    found = [
        Headline(group=group, what=what, who=who, unit=unit, value=value(figures))
        for who, figures in measured.items()
        for what, unit, value in _FIGURES
    ]
    found += [
        Headline(
            group=f"targets: {group}",
            what=verdict.what,
            unit=verdict.unit,
            value=verdict.value,
            target=verdict.target + f" ({verdict.against})" * bool(verdict.against),
            met=verdict.met,
        )
        for verdict in verdicts
    ]
    return found
