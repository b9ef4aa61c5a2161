"""Both kinds of replay: which recording, through which link."""

import argparse
import sys
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

from kontur_av.errors import ConfigError, ProtocolError, refused
from pipelines.recording.recorded_parts import read_recording
from pipelines.recording.recorded_session import (
    RecordedSession,
    SentUnit,
    cap_needed_bps,
    read_session,
)
from pipelines.session.options import setup_changes, stream_options
from pipelines.session.setup.setup_file import load_setup, setup_from_text
from pipelines.session.setup.table import (
    GROUND_MIC,
    OPERATOR_CAMERA,
    OPERATOR_MIC,
    VIDEO_PAYLOAD_OCTETS,
    Setup,
    VideoStream,
    VoiceStream,
)

_NOTHING: Mapping[str, object] = MappingProxyType({})
#: The only input of each stream that a setup may leave out.
_INPUTS = {
    "uplink_voice": GROUND_MIC,
    "downlink_video": OPERATOR_CAMERA,
    "downlink_voice": OPERATOR_MIC,
}


def load_replay(
    args: argparse.Namespace, path: Path, *, speed: float = 1.0
) -> tuple[RecordedSession, Setup]:
    """What was sent in a recorded session, in all its parts, and the setup that carries it.

    That is the setup of the recording, or that of `--setup`, with what the options change.
    At another speed it has no voices: a packet of sound lasts 20 ms.
    Raises ConfigError if the file is no recording, or the setup does not carry what was recorded.
    """
    session = _load_recording(path)
    setup = _replay_setup(args, path, session, speed)
    _check_caps(path, setup, session, recode=args.recode, speed=speed)
    return session, setup


def _load_recording(path: Path) -> RecordedSession:
    _, recording = read_recording(path)
    with refused(path, ProtocolError):
        session = read_session(recording)
    for topic, count in session.moved.items():
        line = f"{count} instants were not after the one before, and were moved"
        print(f"kontur-av: {path}: {topic}: {line}", file=sys.stderr)
    return session


def _replay_setup(
    args: argparse.Namespace, path: Path, session: RecordedSession, speed: float
) -> Setup:
    changes = setup_changes(stream_options(args))
    if args.setup is not None:
        start_s = _start_s(args.radio_start, session, changes)
        setup = load_setup(args.setup, changes=changes, radio_start_s=start_s)
    else:
        setup = recorded_setup(path, session, changes, radio_start_s=args.radio_start)
    if speed != 1.0:
        voices = (one.name for one in setup.streams if isinstance(one, VoiceStream))
        setup = _without(setup, tuple(voices))
    # A partner is not recorded in full, and nobody joins a replay.
    setup = replace(setup, rtc=None)
    setup = _changed(setup, _caps(args.cap_kbps, setup))
    for stream in _silent(setup, session):
        raise ConfigError(f"{path} has no channel /{stream}/sent: take a setup without {stream}")
    return setup


def recorded_setup(
    path: Path,
    session: RecordedSession,
    changes: Mapping[str, object] = _NOTHING,
    *,
    radio_start_s: float | None = None,
) -> Setup:
    """The setup of the recording, with `changes`, without streams of which it has nothing.

    radio_start_s: as of `load_setup`; None: that of the recording, unless its radio is changed.
    Raises ConfigError if it does not work here.
    """
    try:
        setup = setup_from_text(
            session.metadata.setup_toml,
            changes=changes,
            radio_start_s=_start_s(radio_start_s, session, changes),
        )
    except ConfigError as error:
        raise ConfigError(
            f"{path}: its setup does not work here ({error}): give another with --setup, or a "
            "radio with --radio"
        ) from None
    return _without(setup, tuple(_silent(setup, session)))


def _start_s(
    wanted_s: float | None, session: RecordedSession, changes: Mapping[str, object]
) -> float | None:
    if wanted_s is None and not changes.get("radio") and session.metadata.radio_start_s:
        return session.metadata.radio_start_s
    return wanted_s


def _check_caps(
    path: Path, setup: Setup, session: RecordedSession, *, recode: bool, speed: float
) -> None:
    """ConfigError if a recorded stream does not fit under its cap."""
    recorded = {stream.name: stream.cap_bps for stream in _recorded_streams(session)}
    for stream in setup.streams:
        video = isinstance(stream, VideoStream)
        if video and recode:
            continue
        units = (session.pictures if video else session.voices).get(stream.name, [])
        if isinstance(stream, VideoStream) and units and units[0].codec != stream.codec:
            raise ConfigError(
                f"{path}: {stream.name} is {units[0].codec}, in a setup that has {stream.codec}: "
                f'take a setup with codec = "{units[0].codec}", or --recode'
            )
        recorded_bps = recorded.get(stream.name, 0) or _mean_bps(units)
        needed_bps = cap_needed_bps(
            [(unit.capture_ns, len(unit.data)) for unit in units],
            cap_bps=stream.cap_bps,
            recorded_bps=recorded_bps,
            channel_bps=setup.profile_of(stream).media_bps,
            payload_octets=VIDEO_PAYLOAD_OCTETS,
            speed=speed,
        )
        if needed_bps > stream.cap_bps:
            fix = ", or --recode" if video else ""
            raise ConfigError(
                f"{path}: {stream.name} needs a cap of {needed_bps / 1000:g} kbit/s, not "
                f"{stream.cap_bps / 1000:g}: give --cap-kbps {stream.name}={needed_bps / 1000:g}"
                f"{fix}"
            )


def _recorded_streams(session: RecordedSession) -> tuple[VideoStream | VoiceStream, ...]:
    try:
        return setup_from_text(session.metadata.setup_toml, changes={"radio": "cable"}).streams
    except ConfigError:
        return ()


def _mean_bps(units: list[SentUnit]) -> int:
    seconds = max((units[-1].capture_ns - units[0].capture_ns) / 1e9, 1.0) if units else 1.0
    return round(8 * sum(len(unit.data) for unit in units) / seconds)


def _silent(setup: Setup, session: RecordedSession) -> Iterator[str]:
    """Streams of the setup that are not in the recording; that of the uplink cannot be left out."""
    for stream in setup.streams:
        known = session.pictures if isinstance(stream, VideoStream) else session.voices
        if stream.name not in known and stream.name != setup.uplink_video.name:
            yield stream.name


def _without(setup: Setup, streams: tuple[str, ...]) -> Setup:
    """The setup without these streams: what was not recorded cannot be sent."""
    inputs = {_INPUTS[name] for name in streams}
    sources = {name: spec for name, spec in setup.sources.items() if name not in inputs}
    return _changed(setup, {**dict.fromkeys(streams), "sources": sources})


def _changed(setup: Setup, fields: Mapping[str, object]) -> Setup:
    return replace(setup, **fields)  # type: ignore[arg-type]


def _caps(options: list[str], setup: Setup) -> Mapping[str, object]:
    streams = {stream.name: stream for stream in setup.streams}
    for option in options:
        name, _, text = option.partition("=")
        try:
            cap_bps = round(float(text) * 1000)
        except (ValueError, OverflowError):
            cap_bps = 0
        if name not in streams or cap_bps <= 0:
            known = ", ".join(streams)
            raise ConfigError(
                f"--cap-kbps {option}: write STREAM=KBPS with one of {known}, like uplink_video=60"
            )
        streams[name] = replace(streams[name], cap_bps=cap_bps)
    return {name: streams[name] for name in streams}
