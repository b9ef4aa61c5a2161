"""The figures by which a session of a pass is judged, and the verdict. A core."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from kontur_av.clock import NS_PER_MS, NS_PER_S
from pipelines.bench.result import Headline, JsonReader
from pipelines.virtual.campaign.tasks import Crash

#: The least share of the usable time that the orbit predicts.
USABLE_SHARE = 0.99
#: A stream that shows nothing, or a channel that moves no sample, is stuck after this time with a
#: signal in the predicted window.
LONGEST_PAUSE_S = {"shown": 3.0, "felt": 1.0}
#: One-way delays that a session of samples takes to begin (docs/haptics-sample.md).
HAPTIC_BEGIN_DELAYS = 5
#: Rounding down at both ports makes the observed energy too small by this at most (µJ).
ROUNDING_UJ = 2
#: The largest rate over 100 ms, as a share of the cap (docs/video.md).
BURST_SHARE = 1.5


@dataclass(frozen=True, slots=True, kw_only=True)
class Frames:
    """Frames of one direction of the link."""

    frames: int
    frames_lost: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Haptic:
    """Samples of one direction. latency_ms: percentiles, `max` and `count`."""

    sent: int
    received: float
    latency_ms: dict[str, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class LongestPauses:
    """The longest pause (s) with a signal: of any stream, and of samples in any direction."""

    shown: float
    felt: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Stream:
    """One media stream; a count or a duration that the stream does not have is None.

    latency_ms: percentiles, `max` and `count`. cap_share, burst_share: the largest rate over 1 s
    and over 100 ms, as shares of the cap.
    """

    latency_ms: dict[str, float]
    cap_share: float
    burst_share: float
    rtp_packets: int | None = None
    rtp_lost: int | None = None
    frames_captured: int | None = None
    frames_displayed: int | None = None
    frames_concealed: int | None = None
    stale_ms: float | None = None
    stale_episodes: int | None = None
    frozen_ms: float | None = None
    frozen_episodes: int | None = None
    damaged_ms: float | None = None
    damaged_episodes: int | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Contacts:
    """Contacts with a target; `missed` and `skew_ms` by sense and by pair of senses."""

    events: int
    missed: dict[str, int | None]
    skew_ms: dict[str, dict[str, float] | None]


@dataclass(frozen=True, slots=True, kw_only=True)
class PassFigures:
    """One session.

    predicted_s, usable_s: the time that the orbit predicts as usable, and what of it had a signal;
    None where the radio has no contact. longest_delay_s: of the radio. signal_s: time with a
    signal, at the end that had less. contacts, frames_hit: by end. video_lead_ms: by how much force
    came before its picture. least_energy_uj: the least energy that a passivity observer saw.
    """

    seconds: float
    predicted_s: float | None
    usable_s: float | None
    longest_delay_s: float
    signal_s: float
    contacts: dict[str, int]
    frames: dict[str, Frames]
    frames_hit: dict[str, int]
    haptic: dict[str, Haptic]
    longest_pause_s: LongestPauses
    streams: dict[str, Stream]
    skew_ms: dict[str, dict[str, float] | None]
    lip_sync: dict[str, float] | None
    video_lead_ms: float | None
    sync: Contacts | None
    least_energy_uj: float | None
    failures: list[str]


Session = PassFigures | Crash


def pass_figures(report: JsonReader, *, start_s: float = 0.0) -> PassFigures:
    """The figures of a session.

    start_s: when the session began, after the acquisition of signal.
    """
    window = usable_window(report, start_s)
    gateways = dict(report.items("gateways"))
    ends = {end: of.at("supervision") for end, of in gateways.items() if of.has("supervision")}
    radio = report.at("gateways", "ground")
    return PassFigures(
        seconds=report.number("seconds"),
        predicted_s=None if window is None else round(window[1] - window[0], 3),
        usable_s=None if window is None else round(signal_s(report, *window), 3),
        longest_delay_s=(radio.number_or_none("radio", "delay_max_ns") or 0) / NS_PER_S,
        signal_s=min((of.number("contact_ns") / NS_PER_S for of in ends.values()), default=0.0),
        contacts={end: of.count("counts", "signals_acquired") for end, of in ends.items()},
        frames={
            name: Frames(frames=link.count("frames"), frames_lost=link.count("frames_lost"))
            for name, link in report.items("link")
        },
        frames_hit={
            end: of.count("radio", "frames_hit") for end, of in gateways.items() if of.has("radio")
        },
        haptic={
            name: Haptic(
                sent=of.count("sent"),
                received=of.number("received"),
                latency_ms=_numbers(of.at("latency_ms")),
            )
            for name, of in report.items("haptic")
        },
        longest_pause_s=LongestPauses(
            shown=_longest_pause_s(report, "streams", window),
            felt=_longest_pause_s(report, "haptic", window),
        ),
        streams={name: _stream(stream) for name, stream in report.items("streams")},
        skew_ms={
            name: None if of.value is None else _numbers(of) for name, of in report.items("skew_ms")
        },
        lip_sync=_numbers(report.at("lip_sync")) if report.has("lip_sync") else None,
        video_lead_ms=report.number_or_none("video_lead", "lead_ms", "total"),
        sync=_contacts(report.at("sync")) if report.has("sync") else None,
        least_energy_uj=least_energy_uj(report),
        failures=[failure.text() for failure in report.elements("failures")],
    )


def _numbers(of: JsonReader) -> dict[str, float]:
    """The numbers of an object, without its other values."""
    return {
        name: value.number()
        for name, value in of.items()
        if isinstance(value.value, int | float) and not isinstance(value.value, bool)
    }


def _stream(stream: JsonReader) -> Stream:
    def count(name: str) -> int | None:
        return stream.count(name) if stream.has(name) else None

    def milliseconds(name: str) -> float | None:
        return round(stream.number(name) / NS_PER_MS, 3) if stream.has(name) else None

    cap_bps = stream.number("cap_bps")
    return Stream(
        latency_ms=_numbers(stream.at("latency_ms")),
        cap_share=round(stream.number("payload_bps_max_1s") / cap_bps, 4),
        burst_share=round(stream.number("payload_bps_max_100ms") / cap_bps, 4),
        rtp_packets=count("rtp_packets"),
        rtp_lost=count("rtp_lost"),
        frames_captured=count("frames_captured"),
        frames_displayed=count("frames_displayed"),
        frames_concealed=count("frames_concealed"),
        stale_ms=milliseconds("stale_ns"),
        stale_episodes=count("stale_episodes"),
        frozen_ms=milliseconds("frozen_ns"),
        frozen_episodes=count("frozen_episodes"),
        damaged_ms=milliseconds("damaged_ns"),
        damaged_episodes=count("damaged_episodes"),
    )


def _contacts(sync: JsonReader) -> Contacts:
    return Contacts(
        events=sync.count("events"),
        missed={
            sense: of.count("missed") if of.value is not None else None
            for sense, of in sync.items("senses")
        },
        skew_ms={
            pair: None if of.value is None else _numbers(of) for pair, of in sync.items("skew_ms")
        },
    )


def usable_window(report: JsonReader, start_s: float) -> tuple[float, float] | None:
    """Begin and end (s) of the usable contact in the session, as the orbit predicts it.

    The whole session where the radio has no orbit; None where the session misses the contact.
    """
    ground, seconds = report.at("gateways", "ground"), report.number("seconds")
    if not ground.has("radio", "contact"):
        return 0.0, seconds
    contact = ground.at("radio", "contact")
    begin_s = max(0.0, contact.number("usable_from_s") - start_s)
    end_s = min(seconds, contact.number("usable_to_s") - start_s)
    return (begin_s, end_s) if end_s > begin_s else None


def signal_s(report: JsonReader, begin_s: float, end_s: float) -> float:
    """The time (s) between two instants in which an end had a signal, at the end that had less."""
    heard = []
    for _, gateway in report.items("gateways"):
        total_ns = 0.0
        for acquired_ns, lost_ns in _windows_ns(gateway):
            last_ns = end_s * NS_PER_S if lost_ns is None else min(lost_ns, end_s * NS_PER_S)
            total_ns += max(0, last_ns - max(acquired_ns, begin_s * NS_PER_S))
        heard.append(total_ns / NS_PER_S)
    return min(heard, default=0.0)


def _windows_ns(gateway: JsonReader) -> Iterator[tuple[float, float | None]]:
    """(acquisition, loss) of each contact of one end; None for one that lasts."""
    if gateway.has("supervision", "contacts"):
        for window in gateway.elements("supervision", "contacts"):
            yield window.number("acquired_ns"), window.number_or_none("lost_ns")


def _longest_pause_s(
    report: JsonReader, channels: str, window: tuple[float, float] | None
) -> float:
    """The longest part of a pause of one of `channels` with a signal throughout, in the window."""
    if window is None:
        return 0.0
    longest_s = 0.0
    for name, channel in report.items(channels):
        # The signal at the receiving end counts.
        end = "space" if name.startswith("up") else "ground"
        contacts = list(_windows_ns(report.at("gateways", end)))
        for pause in channel.elements("pauses_s"):
            begin_s, end_s = (instant.number() for instant in pause.elements())
            for acquired_ns, lost_ns in contacts:
                last_s = report.number("seconds") if lost_ns is None else lost_ns / NS_PER_S
                first_s = max(begin_s, acquired_ns / NS_PER_S, window[0])
                longest_s = max(longest_s, min(end_s, last_s, window[1]) - first_s)
    return round(longest_s, 3)


def least_energy_uj(report: JsonReader) -> float | None:
    """The least energy (µJ) that a passivity observer has seen; None if there is none."""
    places = (report.at(name) for name in ("haptic", "processes") if report.has(name))
    return min((least for place in places for least in _values("least_uj", place)), default=None)


def _values(name: str, table: JsonReader) -> Iterator[float]:
    for key, part in table.items():
        if isinstance(part.value, Mapping):
            yield from _values(name, part)
        elif key == name and part.value is not None:
            yield part.number()


def faults(session: Session) -> list[str]:
    """What is wrong with a session, one word each; an empty list means a usable pass."""
    if isinstance(session, Crash):
        return ["crashed"]
    found = []
    predicted_s, usable_s = session.predicted_s, session.usable_s
    if (
        predicted_s is None
        or usable_s is None
        or usable_s < USABLE_SHARE * predicted_s - _acquisition_s(session)
    ):
        found.append("unusable")
    pauses = session.longest_pause_s
    felt_s = LONGEST_PAUSE_S["felt"] + HAPTIC_BEGIN_DELAYS * session.longest_delay_s
    if pauses.shown > LONGEST_PAUSE_S["shown"] or pauses.felt > felt_s:
        found.append("stuck")
    if session.least_energy_uj is not None and session.least_energy_uj < -ROUNDING_UJ:
        found.append("unstable")
    if any(of.cap_share > 1 or of.burst_share > BURST_SHARE for of in session.streams.values()):
        found.append("over its cap")
    if session.failures:
        found.append("failed")
    return found


def _acquisition_s(session: PassFigures) -> float:
    """How long the acquisition of signal may take at the beginning, with the radio's delay."""
    if session.predicted_s != session.seconds:
        return 0.0
    return 0.1 + session.longest_delay_s


#: Of the table of sessions. lost: of all frames, also outside the usable time; shown/s: pictures
#: per second of signal; skew: video after force; hurt: damaged; cap: the largest second of any
#: stream, as a share of its cap.
HEADINGS = (
    "seed",
    "usable s",
    "contacts",
    "lost up/down %",
    "force p99.9",
    "video p50/p99",
    "shown/s",
    "voice p99",
    "skew p95",
    "lip-sync %",
    "stale/ frozen/ hurt s",
    "cap %",
    "least µJ",
    "verdict",
)


def table_rows(sessions: Mapping[int, Session]) -> Iterator[tuple[str, ...]]:
    """The cells of each session, in the order of its seed."""
    for seed in sorted(sessions):
        yield (str(seed), *_cells(sessions[seed]))


def _cells(session: Session) -> tuple[str, ...]:
    verdict = ", ".join(faults(session)) or "usable"
    if isinstance(session, Crash):
        return *[""] * (len(HEADINGS) - 2), verdict
    streams = session.streams
    video, voice = streams.get("uplink_video"), streams.get("uplink_voice")
    skew, together = session.skew_ms.get("video_haptic"), session.lip_sync
    lost = [f"{100 * of.frames_lost / max(1, of.frames):.2f}" for of in session.frames.values()]
    shown = 0 if video is None else video.frames_displayed or 0
    return (
        "none"
        if session.usable_s is None
        else f"{session.usable_s:.1f} of {session.predicted_s:.1f}",
        str(max(session.contacts.values(), default=0)),
        " / ".join(lost),
        _latencies(session.haptic["up"].latency_ms, "p99.9"),
        "" if video is None else _latencies(video.latency_ms, "p50", "p99"),
        "" if video is None else f"{shown / max(1e-9, session.signal_s):.1f}",
        "" if voice is None else _latencies(voice.latency_ms, "p99"),
        "" if skew is None else f"{skew['p95']:.1f}",
        "" if together is None else f"{100 * together['within']:.2f}",
        "" if video is None else _spells(video),
        f"{100 * max((of.cap_share for of in streams.values()), default=0):.1f}",
        "" if session.least_energy_uj is None else f"{session.least_energy_uj:g}",
        verdict,
    )


def _spells(video: Stream) -> str:
    durations_ms = (video.stale_ms, video.frozen_ms, video.damaged_ms)
    return " / ".join(f"{(duration_ms or 0) / 1000:.1f}" for duration_ms in durations_ms)


def _latencies(latency_ms: Mapping[str, float], *names: str) -> str:
    """Percentiles; nothing for a channel that carried nothing."""
    if not latency_ms["count"]:
        return ""
    return " / ".join(f"{latency_ms[name]:.1f}" for name in names)


def markdown(sessions: Mapping[int, Session], title: str) -> str:
    """The table for a document."""
    lines = [title, "", _line(HEADINGS), "|" + "|".join(["--:"] * (len(HEADINGS) - 1)) + "|---|"]
    lines += [_line(row) for row in table_rows(sessions)]
    return "\n".join([*lines, "", summary(sessions), ""])


def _line(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cells) + " |"


def summary(sessions: Mapping[int, Session]) -> str:
    """All sessions in a sentence."""
    words: dict[str, int] = {}
    for session in sessions.values():
        for word in faults(session):
            words[word] = words.get(word, 0) + 1
    others = "".join(f", {count} {word}" for word, count in words.items())
    sentence = f"{_usable(sessions)} of {len(sessions)} sessions usable{others}."
    if force := _force_ms(sessions):
        sentence += f" Force at most {max(force):.1f} ms on its way."
    if worst := _video_p99_ms(sessions):
        sentence += f" Video p99 from {min(worst):.1f} to {max(worst):.1f} ms."
    return sentence


def _usable(sessions: Mapping[int, Session]) -> int:
    return sum(not faults(session) for session in sessions.values())


def _whole(sessions: Mapping[int, Session]) -> list[PassFigures]:
    return [session for session in sessions.values() if isinstance(session, PassFigures)]


def _force_ms(sessions: Mapping[int, Session]) -> list[float]:
    """The largest latency of the force in each session that carried some."""
    found = [session.haptic["up"].latency_ms for session in _whole(sessions)]
    return [latency_ms["max"] for latency_ms in found if latency_ms["count"]]


def _video_p99_ms(sessions: Mapping[int, Session]) -> list[float]:
    """The p99 of the uplink's picture in each session that showed some."""
    videos = [session.streams.get("uplink_video") for session in _whole(sessions)]
    found = [video.latency_ms for video in videos if video is not None]
    return [latency_ms["p99"] for latency_ms in found if latency_ms["count"]]


def headlines(sessions: Mapping[int, Session]) -> list[Headline]:
    """The figures of all sessions for the page of measurements."""
    usable = _usable(sessions)
    found = [
        Headline(
            what="usable sessions",
            unit="",
            value=usable,
            target=f"all {len(sessions)}",
            met=usable == len(sessions),
        )
    ]
    for what, values in (
        ("force, one way, largest", _force_ms(sessions)),
        ("uplink picture, p99 of the worst session", _video_p99_ms(sessions)),
    ):
        if values:
            found.append(Headline(what=what, unit="ms", value=max(values)))
    least_uj = [of.least_energy_uj for of in _whole(sessions) if of.least_energy_uj is not None]
    if least_uj:
        what = "least energy that a passivity observer saw"
        found.append(Headline(what=what, unit="µJ", value=min(least_uj)))
    return found
