"""What the commands that speak WebRTC send, what becomes of what comes, and how long they run."""

import argparse
import asyncio
from collections.abc import AsyncIterator, Callable, Sequence

from kontur_av.clock import Clock, MonotonicClock
from kontur_av.codecs.coding import SLOW_REFRESH_S
from kontur_av.codecs.decoder import DecodedPicture
from kontur_av.codecs.h26x import H264Decoder, H264Encoder
from kontur_av.codecs.opus import OpusEncoder
from kontur_av.errors import ConfigError
from kontur_av.media import VIDEO_CLOCK_HZ, AccessUnit, CaptureStamp, parse_size
from kontur_av.meters import Histogram
from kontur_av.report import latency_ms
from kontur_av.rtp.nal_depacketizer import ReceivedUnit
from kontur_av.rtp.receiver import RtpReceived
from kontur_av.streams.voice_receiver import VoicePlayer
from pipelines.commands.rtc_options import ice_servers_of, token_of
from pipelines.media.sending import check_alone, open_pictures, open_sound
from pipelines.partner.coded_sources import CodedSources
from pipelines.partner.decisions import LEAST_BPS
from pipelines.partner.description import Kind
from pipelines.partner.ice_servers import IceServers
from pipelines.partner.media import PictureCame, SoundCame
from pipelines.partner.peer import ReceivedKind, RtcConnection, RtcPeer, connection_report
from pipelines.partner.whip import Keeper
from pipelines.recording.matroska import MatroskaWriter
from pipelines.recording.raw_pictures import RawPictures
from pipelines.recording.received_media import SoundLine, TimeLine
from pipelines.session.command_process import say, stopped_by_signals
from pipelines.session.options import stream_options

_LOOK_S = 0.2
#: The common rows of what is sent, and of what becomes of what comes.
SENDING = ("--video", "--audio", "--size", "--fps", "--video-kbps", "--voice-kbps")
OUTPUT = ("--save", "--save-voice", "--raw")


async def driven(
    seconds: float | None, running: asyncio.Future[None] | None = None
) -> AsyncIterator[None]:
    """Yield five times a second, until the time is over, a signal comes, or `running` has ended.

    Raises what `running` raises.
    """
    loop = asyncio.get_running_loop()
    end_s = None if seconds is None else loop.time() + seconds
    with stopped_by_signals() as stopped:
        while not stopped() and (end_s is None or loop.time() < end_s):
            if running is not None and running.done():
                running.result()
                return
            yield
            await asyncio.sleep(_LOOK_S)


def keeper_of(
    args: argparse.Namespace,
    url: str,
    make_peer: Callable[[IceServers], RtcPeer],
    clock: Clock,
) -> Keeper[RtcPeer]:
    """Return a connection to a media server at `url`, as the options say. It prints its changes."""
    return Keeper(
        url,
        token=token_of(args),
        token_origins=args.token_origin,
        make_peer=make_peer,
        servers=ice_servers_of(stream_options(args), may_be_named=True),
        clock=clock,
        told=say,
    )


async def keep(
    seconds: float | None, keeper: Keeper[RtcPeer], look: Callable[[], None]
) -> RtcConnection | None:
    """Keep the connection until the command ends; figures of the newest one.

    look: called five times a second.
    """
    newest = None
    running = asyncio.create_task(keeper.run())
    async for _ in driven(seconds, running):
        look()
        if keeper.peer is not None:
            newest = connection_report(keeper.peer) or newest
    if keeper.peer is not None:
        newest = connection_report(keeper.peer) or newest
    keeper.stop()
    await running
    return newest


def sends_of(args: argparse.Namespace) -> dict[Kind, int]:
    """Return the bit/s of what is sent, by kind. ConfigError for rates that cannot work."""
    check_alone(args.video)
    check_alone(args.audio)
    sends: dict[Kind, int] = {}
    if args.video is not None:
        sends["video"] = _bps(args.video_kbps, "--video-kbps", LEAST_BPS, 50_000_000)
    if args.audio is not None:
        sends["audio"] = _bps(args.voice_kbps, "--voice-kbps", 6_000, 510_000)
    return sends


def _bps(kbps: float, option: str, least: int, most: int) -> int:
    bps = round(kbps * 1000)
    if not least <= bps <= most:
        raise ConfigError(f"{option} {kbps:g}: take {least / 1000:g} to {most / 1000:g}")
    return bps


def coded_sources(
    args: argparse.Namespace,
    clock: MonotonicClock,
    *,
    send_unit: Callable[[AccessUnit], None],
    send_opus: Callable[[bytes, CaptureStamp], None],
) -> CodedSources:
    """Begin to code the sources. ConfigError for those that cannot be opened."""
    sends = sends_of(args)
    most_bps = sends.get("video", LEAST_BPS)
    sources = CodedSources(clock, most_bps=most_bps, send_unit=send_unit, send_opus=send_opus)
    if args.video is not None:
        width, height = parse_size(args.size)
        encoder = H264Encoder(
            width=width, height=height, fps=args.fps, cap_bps=most_bps, refresh_s=SLOW_REFRESH_S
        )
        sources.add_pictures(open_pictures(args, clock), encoder)
    if args.audio is not None:
        sources.add_sound(open_sound(args, clock), OpusEncoder(bitrate_bps=sends["audio"]))
    return sources


class PartnerOutput:
    """Takes the events of a connection. `close` it at the end.

    ConfigError for files that cannot be written.
    """

    def __init__(self, args: argparse.Namespace, clock: MonotonicClock) -> None:
        self._clock = clock
        self._decoder = H264Decoder(reordered=True)
        self._player = VoicePlayer()
        self._files: list[MatroskaWriter] = []
        self._picture_file = self._open(args.save)
        self._voice_file = self._open(args.save_voice)
        self._raw = None if args.raw is None else RawPictures(args.raw)
        # A partner may come again, with other timestamps.
        self._picture_time, self._voice_time = TimeLine(VIDEO_CLOCK_HZ), SoundLine()
        self._picture_ns, self._voice_ns = Histogram(), Histogram()
        self._pictures = self._blocks = 0
        #: Width and height of the newest picture; None before the first.
        self.size: tuple[int, int] | None = None

    def handle(self, event: PictureCame | SoundCame) -> None:
        if isinstance(event, PictureCame):
            self._handle_unit(event.unit, event.capture_ns)
        else:
            self._handle_block(event)

    def flush(self) -> None:
        """Write what a slow reader of --raw has not taken. Call it often."""
        if self._raw is not None and self._raw.pending() is not None:
            self._raw.handle_writable()

    def close(self) -> None:
        for file in self._files:
            file.close()
        if self._raw is not None:
            self._raw.close()

    def finish(self) -> list[str]:
        """Write the rest, close, and say which files could not be written."""
        for picture in self._decoder.drain():
            self._show(picture)
        self._save_voice((), None)
        self.close()
        faults = [file.fault for file in self._files]
        if self._raw is not None:
            faults.append(self._raw.fault)
        return [fault for fault in faults if fault]

    def pictures(self) -> ReceivedKind:
        return _kind(self._pictures, self._picture_ns)

    def voice(self) -> ReceivedKind:
        return _kind(self._blocks, self._voice_ns)

    def _open(self, path: str | None) -> MatroskaWriter | None:
        if path is None:
            return None
        file = MatroskaWriter(path)
        self._files.append(file)
        return file

    def _handle_unit(self, unit: ReceivedUnit, capture_ns: int | None) -> None:
        for picture in self._decoder.decode(unit.data, unit.timestamp):
            self._show(picture)
            if capture_ns is not None and picture.timestamp == unit.timestamp:
                self._picture_ns.add(max(self._clock.now_ns() - capture_ns, 0))
        if self._picture_file is not None:
            ticks = self._picture_time.ticks(
                unit.timestamp, unit.received_ns, follows_all=unit.keyframe
            )
            self._picture_file.add_unit(unit.data, ticks, keyframe=unit.keyframe)

    def _show(self, picture: DecodedPicture) -> None:
        self._pictures += 1
        self.size = picture.width, picture.height
        if self._raw is not None:
            self._raw.handle_picture(picture)

    def _handle_block(self, event: SoundCame) -> None:
        block = event.block
        self._save_voice(event.packets, self._clock.now_ns())
        _, decoded = self._player.play(block)
        if not decoded:
            return
        self._blocks += 1
        if event.capture_ns is not None:
            self._voice_ns.add(max(block.play_ns - event.capture_ns, 0))

    def _save_voice(self, packets: Sequence[RtpReceived], now_ns: int | None) -> None:
        for packet in self._voice_time.packets(packets, now_ns):
            if self._voice_file is not None:
                self._voice_file.add_opus(*packet)


def _kind(decoded: int, latency_ns: Histogram) -> ReceivedKind:
    latency = latency_ms(latency_ns) if latency_ns.count else None
    return ReceivedKind(decoded=decoded, latency_ms=latency)
