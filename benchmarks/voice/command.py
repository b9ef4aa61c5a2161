"""`python -m benchmarks voice`: mouth to ear, rate and quality under loss, beside GStreamer."""

import argparse
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import isnan
from pathlib import Path

from rich.table import Table

from benchmarks.voice.gstreamer import Peer, listen_live, missing
from benchmarks.voice.network import BURST_PACKETS, Network
from benchmarks.voice.speech import LEAD_IN_BLOCKS, Track, pesq_is_there, quality, speech_track
from benchmarks.voice.virtual import Heard, listen, speak
from kontur_av.clock import NS_PER_MS
from kontur_av.errors import ConfigError
from kontur_av.media import AUDIO_CLOCK_HZ
from kontur_av.sources.source import BLOCK_NS
from pipelines.report.charts import check_plot, distributions, save
from pipelines.report.report_file import check_writable, open_console, write_result
from pipelines.report.result import Headline, Percentiles, spread
from pipelines.session.setup.setup_file import load_setup
from pipelines.session.setup.table import VoiceStream

_OURS = "kontur-av"
_LOSSES = (0.0, 0.02, 0.05, 0.10)
#: Latency of GStreamer's jitter buffer, in ms: its default, and what suits this network.
_DEFAULT_MS, _TUNED_MS = 200, 20
_SETUP = "spacejustin"


@dataclass(frozen=True, slots=True, kw_only=True)
class VoiceRow:
    """One voice through one network. loss: its name; lost_percent: of the packets.

    heard_s: length of what came out. made_up_ms: of it concealed or inserted; None if unknown.
    pesq: mean of `pesq_of_turns` (MOS-LQO); None if not measured.
    """

    loss: str
    lost_percent: float
    who: str
    mouth_to_ear_ms: Percentiles
    payload_bps: int
    heard_s: float
    made_up_ms: int | None
    pesq: float | None
    pesq_of_turns: Sequence[float]


@dataclass(frozen=True, slots=True)
class VoiceResult:
    """voice: rows by the cap of the voice."""

    speech_s: float
    voice: Mapping[str, Sequence[VoiceRow]]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of `python -m benchmarks voice`."""
    parser.add_argument(
        "--seconds", type=float, default=40.0, metavar="S", help="of speech (default 40)"
    )
    parser.add_argument(
        "--delay-ms", type=float, default=5.0, metavar="D", help="of the network (default 5)"
    )
    parser.add_argument(
        "--jitter-ms",
        type=float,
        default=5.0,
        metavar="J",
        help="largest random addition for each packet (default 5)",
    )
    parser.add_argument("--seed", type=int, default=1, metavar="N", help="of losses and jitter")
    parser.add_argument("--no-live", action="store_true", help="without GStreamer")
    parser.add_argument("--report", type=Path, metavar="FILE", help="write the figures as JSON")
    parser.add_argument("--plot", type=Path, metavar="FILE", help="draw the latencies as PNG")


def run(args: argparse.Namespace) -> int:
    """Measure, and print each table as soon as it is known."""
    if not 1 <= args.seconds <= 3600:
        raise ConfigError(f"--seconds {args.seconds:g}: give 1 to 3600")
    if not 0 <= args.delay_ms <= 1000:
        raise ConfigError(f"--delay-ms {args.delay_ms:g}: give 0 to 1000")
    if not 0 <= args.jitter_ms <= 20:
        raise ConfigError(f"--jitter-ms {args.jitter_ms:g}: give 0 to 20")
    check_writable(args.report)
    check_plot(args.plot)
    console = open_console(args)
    if not pesq_is_there():
        console.print("no quality: PESQ is missing (pip install 'kontur-av[bench]')", markup=False)
    absent = "left out by --no-live" if args.no_live else missing()
    if absent is not None:
        console.print(f"no GStreamer: {absent}")
    setup = load_setup(_SETUP)
    track = speech_track(args.seconds)
    metrics: dict[str, list[VoiceRow]] = {}
    panels = {}
    for stream in (setup.uplink_voice, setup.downlink_voice):
        assert stream is not None
        name = f"{stream.cap_bps / 1000:g} kbit/s"
        table = _table(stream, track)
        rows, curves = [], {}
        for network, who, heard in _runs(args, track, stream, live=absent is None):
            row = _metrics(track, network, who, heard)
            rows.append(row)
            _add(table, row)
            if not network.bursts and network.loss in (0.0, _LOSSES[-1]):
                label = f"{who}, {100 * network.loss:g} % lost"
                curves[label] = [value / NS_PER_MS for value in heard.mouth_to_ear_ns]
        console.print(table)
        metrics[name] = rows
        panels[f"mouth to ear, voice at {name}"] = curves
    result = VoiceResult(track.blocks * BLOCK_NS / 1e9, metrics)
    write_result(args.report, result, _headlines(metrics))
    if args.plot is not None:
        save(distributions(panels, axis="mouth to ear, ms"), args.plot)
    return 0


def _networks(args: argparse.Namespace) -> list[Network]:
    return [
        Network(
            loss=loss,
            bursts=bursts,
            delay_ms=args.delay_ms,
            jitter_ms=args.jitter_ms,
            seed=args.seed,
        )
        for bursts in (False, True)
        for loss in _LOSSES
        if loss or not bursts
    ]


def _runs(
    args: argparse.Namespace, track: Track, stream: VoiceStream, *, live: bool
) -> Iterator[tuple[Network, str, Heard]]:
    networks = _networks(args)
    setup = load_setup(_SETUP)
    peers = [Peer(networks[0], _DEFAULT_MS), *(Peer(network, _TUNED_MS) for network in networks)]
    theirs: Sequence[Heard] = listen_live(track, stream.cap_bps, peers) if live else ()
    sent = speak(setup, stream, track)
    for network in networks:
        yield network, _OURS, listen(setup, stream, sent, network)
        for peer, heard in zip(peers if live else (), theirs, strict=True):
            if peer.network is network:
                yield network, f"GStreamer, {peer.latency_ms} ms", heard


def _headlines(metrics: Mapping[str, Sequence[VoiceRow]]) -> list[Headline]:
    found = []
    for name, rows in metrics.items():
        for row in rows:
            ms = row.mouth_to_ear_ms
            for what, unit, value in (
                ("mouth to ear, p50", "ms", ms.p50),
                ("mouth to ear, p99", "ms", ms.p99),
                ("PESQ", "MOS-LQO", row.pesq),
            ):
                label = f"loss {row.loss}: {what}"
                found.append(
                    Headline(group=f"at {name}", what=label, who=row.who, unit=unit, value=value)
                )
    return found


def _metrics(track: Track, network: Network, who: str, heard: Heard) -> VoiceRow:
    latency = spread([round(ns / NS_PER_MS, 1) for ns in heard.mouth_to_ear_ns])
    scores = quality(track, heard.samples, heard.lag_samples) if pesq_is_there() else []
    open_to_loss = max(1, track.blocks - LEAD_IN_BLOCKS)
    return VoiceRow(
        loss=network.name,
        lost_percent=round(100 * heard.lost / open_to_loss, 2),
        who=who,
        mouth_to_ear_ms=latency,
        payload_bps=round(heard.payload_octets * 8 * 1e9 / max(1, heard.packets * BLOCK_NS)),
        heard_s=round(len(heard.samples) / AUDIO_CLOCK_HZ, 2),
        made_up_ms=None if heard.made_up_ns is None else round(heard.made_up_ns / NS_PER_MS),
        pesq=round(sum(scores) / len(scores), 3) if scores else None,
        pesq_of_turns=[round(score, 3) for score in scores],
    )


def _table(stream: VoiceStream, track: Track) -> Table:
    table = Table(
        title=f"voice at {stream.cap_bps / 1000:g} kbit/s, {track.blocks * BLOCK_NS / 1e9:.0f} s; "
        "mouth to ear in ms\nkontur-av on virtual time, GStreamer live",
        title_justify="left",
        caption=f"bursts: of {BURST_PACKETS:g} packets on average; PESQ: ITU-T P.862.2, MOS-LQO\n"
        "GStreamer, N ms: rtpjitterbuffer latency=N, its sink in step with the clock",
        caption_justify="left",
    )
    for heading in ("loss", "who"):
        table.add_column(heading)
    for heading in ("lost %", "kbit/s", "p50", "p99", "max", "PESQ"):
        table.add_column(heading, justify="right")
    return table


def _add(table: Table, row: VoiceRow) -> None:
    ms = row.mouth_to_ear_ms
    table.add_row(
        row.loss,
        row.who,
        f"{row.lost_percent:.1f}",
        f"{row.payload_bps / 1000:.1f}",
        *("–" if isnan(value) else f"{value:.1f}" for value in (ms.p50, ms.p99, ms.max)),
        "–" if row.pesq is None else f"{row.pesq:.2f}",
    )
