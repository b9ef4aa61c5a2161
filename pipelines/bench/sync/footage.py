"""Lights, clicks and steps in recordings of a real LED, a real click and a real force.

Each recording is decoded from its beginning to its end. Instants are the time stamps of the file,
so recordings that were started together need no offset.
"""

import csv
from collections.abc import Iterator
from itertools import pairwise
from math import isfinite
from pathlib import Path

import av
import numpy as np
from av.error import FFmpegError

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.detect import ClickDetector, LightDetector, Roi
from kontur_av.errors import ConfigError
from kontur_av.media import AUDIO_CLOCK_HZ
from pipelines.report.sync_figures import SensedEvent
from pipelines.report.sync_matching import Matched, match_around
from telepresence.haptics.step_detector import StepDetector

#: Whole pictures are scaled down to this width at most, and searched in this many columns of cells:
#: a real LED may be small.
_WIDEST = 1280
_COLUMNS = 160
#: A light or a click lies at most this far from the step that it belongs to.
_AROUND_NS = 750 * NS_PER_MS
#: A time stamp that differs by more than this from the count of samples is a jump in the recording.
_JUMP_NS = 5 * NS_PER_MS


def lights(path: Path, roi: Roi | None) -> list[Matched]:
    """The lights that come on in a video file. roi: pixels of the file's pictures.

    ConfigError if it cannot be read.
    """
    eye = LightDetector(roi=roi, columns=_COLUMNS)
    found: list[Matched] = []
    instants: set[int] = set()
    for instant_ns, frame in _decoded(path, "video"):
        assert isinstance(frame, av.VideoFrame)
        widest = _WIDEST
        if roi is not None:
            if roi.left + roi.width > frame.width or roi.top + roi.height > frame.height:
                size = f"{frame.width}x{frame.height}"
                raise ConfigError(f"--roi: the picture of {path} has {size} pixels")
            # A region is searched at the full resolution.
            widest = frame.width
        width = max(16, min(widest, frame.width) // 4 * 4)
        height = max(16, round(frame.height * width / frame.width) // 4 * 4)
        picture = frame.reformat(width=width, height=height, format="yuv420p").to_ndarray()
        eye.handle_picture(np.asarray(picture, np.uint8), instant_ns, instant_ns)
        instants.add(instant_ns)
        for light in iter(eye.next_event, None):
            slack_ns = light.instant_ns - light.previous_tag
            found.append(Matched(light.instant_ns, light.strength, slack_ns=slack_ns))
    if len(instants) < 4:
        raise ConfigError(f"{path}: it has fewer than 4 pictures with a time stamp")
    return found


def clicks(path: Path) -> list[Matched]:
    """The clicks in a file with sound. ConfigError if it cannot be read."""
    ear = ClickDetector()
    resampler = av.AudioResampler("s16", "mono", AUDIO_CLOCK_HZ)
    found: list[Matched] = []
    due_ns: int | None = None

    def hear(piece: av.AudioFrame) -> None:
        nonlocal due_ns
        at_ns = due_ns
        if piece.time is not None:
            told_ns = round(piece.time * NS_PER_S)
            if due_ns is None or abs(told_ns - due_ns) > _JUMP_NS:
                at_ns = told_ns
        samples = piece.to_ndarray().reshape(-1).astype(np.int16, copy=False)
        at_ns = at_ns or 0
        ear.handle_block(samples, at_ns, at_ns)
        due_ns = at_ns + len(samples) * NS_PER_S // AUDIO_CLOCK_HZ
        found.extend(
            Matched(click.instant_ns, click.strength) for click in iter(ear.next_event, None)
        )

    for _, frame in _decoded(path, "audio"):
        assert isinstance(frame, av.AudioFrame)
        for piece in resampler.resample(frame):
            hear(piece)
    for piece in resampler.resample(None):
        hear(piece)
    if due_ns is None:
        raise ConfigError(f"{path}: there is no sound in it")
    # Silence, so that a click at the very end is complete.
    ear.handle_block(np.zeros(AUDIO_CLOCK_HZ // 20, np.int16), due_ns, due_ns)
    found.extend(Matched(click.instant_ns, click.strength) for click in iter(ear.next_event, None))
    return found


def steps(path: Path) -> list[Matched]:
    """The steps in a table `time_s,force_n`. ConfigError, with the line, for a wrong table."""
    detector = StepDetector()
    rows = list(_rows(path))
    if len(rows) < 2:
        raise ConfigError(f"{path}: it has fewer than 2 rows of time_s,force_n")
    for (_, before_s, _), (line, after_s, _) in pairwise(rows):
        if after_s <= before_s:
            raise ConfigError(f"{path}: line {line}: time does not increase after {before_s:g} s")
    found: list[Matched] = []
    for _, time_s, force_n in rows:
        detector.handle_sample(round(time_s * NS_PER_S), force_n)
        while (step := detector.next_event()) is not None:
            found.append(Matched(step.instant_ns, step.rise_n))
    return found


def joined(found: dict[str, list[Matched]]) -> list[SensedEvent]:
    """Join what belongs to one event. found: by sense, at least two of light, click and force.

    Lights and clicks are joined to the force, or clicks to the light if there is no force; each to
    the nearest one.
    """
    reference = "force" if "force" in found else "light"
    instants = [one.instant_ns for one in found[reference]]
    matched = {
        sense: list(some)
        if sense == reference
        else match_around(instants, some, around_ns=_AROUND_NS)
        for sense, some in found.items()
    }
    return [
        SensedEvent(
            one.instant_ns,
            -1,
            {
                sense: matched[sense][index] if sense in matched else None
                for sense in ("light", "click", "force")
            },
        )
        for index, one in enumerate(found[reference])
    ]


def _decoded(path: Path, kind: str) -> Iterator[tuple[int, av.VideoFrame | av.AudioFrame]]:
    """Frames of the file's first stream of that kind, each with its instant (ns)."""
    if not path.is_file():
        raise ConfigError(f"{path}: there is no such file")
    try:
        with av.open(str(path)) as container:
            streams = container.streams.video if kind == "video" else container.streams.audio
            if not streams:
                what = "picture" if kind == "video" else "sound"
                raise ConfigError(f"{path}: there is no {what} in it")
            for frame in container.decode(streams[0]):
                if isinstance(frame, av.VideoFrame | av.AudioFrame) and frame.time is not None:
                    yield round(frame.time * NS_PER_S), frame
    except (FFmpegError, OSError) as error:
        raise ConfigError(f"{path}: not a media file that can be read ({error.strerror})") from None


def _rows(path: Path) -> Iterator[tuple[int, float, float]]:
    """(line, time in s, force in N) of each row after the heading."""
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            table = csv.reader(file)
            heading = next(table, [])
            if [name.strip() for name in heading[:2]] != ["time_s", "force_n"]:
                raise ConfigError(f"{path}: line 1: begin with the heading time_s,force_n")
            for row in table:
                if not row:
                    continue
                try:
                    time_s, force_n = float(row[0]), float(row[1])
                except (ValueError, IndexError):
                    time_s = force_n = float("nan")
                if not (isfinite(time_s) and isfinite(force_n)):
                    raise ConfigError(f"{path}: line {table.line_num}: give two numbers")
                yield table.line_num, time_s, force_n
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        reason = getattr(error, "strerror", None) or "no table of text"
        raise ConfigError(f"{path}: {reason}") from None
