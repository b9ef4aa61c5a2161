"""What a session of a pass is judged by: a few figures out of its report, and a verdict. A core."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from kontur_av.clock import NS_PER_S
from pipelines.bench.result import Headline

#: Of the time that the orbit predicts as usable, this share must have been.
USABLE_SHARE = 0.99
#: What shows or feels nothing for longer, while there is a signal and the orbit predicts one, is
#: stuck: pictures and sounds, and samples.
LONGEST_PAUSE_S = {"shown": 3.0, "felt": 1.0}
#: Rounding down at both ports makes the observed energy short by this much at most (µJ).
ROUNDING_UJ = 2
#: Over no 100 ms more than this of a cap's share (docs/video.md).
BURST_SHARE = 1.5
_SPELLS = ("stale", "frozen", "damaged")
_SENSES = ("video_haptic", "audio_haptic", "audio_video")

Figures = dict[str, Any]


def pass_figures(report: Mapping[str, Any], *, start_s: float = 0.0) -> Figures:
    """What is kept of a session.

    start_s: how long after the contact's acquisition the session began.
    """
    window = usable_window(report, start_s)
    ends = {
        end: told["supervision"]
        for end, told in report["gateways"].items()
        if "supervision" in told
    }
    usable_s = None if window is None else round(signal_s(report, *window), 3)
    return {
        "seconds": report["seconds"],
        "predicted_s": None if window is None else round(window[1] - window[0], 3),
        "usable_s": usable_s,
        "longest_delay_s": report["gateways"]["ground"].get("radio", {}).get("delay_max_ns", 0)
        / NS_PER_S,
        "signal_s": min((told["contact_ns"] / NS_PER_S for told in ends.values()), default=0.0),
        "contacts": {end: told["counts"]["signals_acquired"] for end, told in ends.items()},
        "frames": {
            name: {key: link[key] for key in ("frames", "frames_lost")}
            for name, link in report["link"].items()
        },
        "frames_hit": {
            end: told["radio"]["frames_hit"]
            for end, told in report["gateways"].items()
            if "radio" in told
        },
        "haptic": {
            name: {
                "sent": haptic["sent"],
                "received": haptic["received"],
                "latency_ms": haptic["latency_ms"],
            }
            for name, haptic in report["haptic"].items()
        },
        "longest_pause_s": {
            "shown": _longest_pause_s(report, report["streams"], window),
            "felt": _longest_pause_s(report, report["haptic"], window),
        },
        "streams": {name: _stream(stream) for name, stream in report["streams"].items()},
        "skew_ms": report["skew_ms"],
        "lip_sync": report["lip_sync"],
        "video_lead_ms": (report.get("video_lead") or {}).get("lead_ms", {}).get("total"),
        "sync": _sync(report.get("sync")),
        "least_energy_uj": least_energy_uj(report),
        "failures": report["failures"],
    }


def _stream(stream: Mapping[str, Any]) -> Figures:
    counts = ("rtp_packets", "rtp_lost", "frames_captured", "frames_displayed", "frames_concealed")
    return {
        **{name: stream[name] for name in counts if name in stream},
        "latency_ms": {
            key: value for key, value in stream["latency_ms"].items() if key != "stages"
        },
        "cap_share": round(stream["payload_bps_max_1s"] / stream["cap_bps"], 4),
        "burst_share": round(stream["payload_bps_max_100ms"] / stream["cap_bps"], 4),
        **{
            f"{spell}_{unit}": stream[f"{spell}_{unit}"]
            for spell in _SPELLS
            for unit in ("ms", "episodes")
            if f"{spell}_{unit}" in stream
        },
    }


def _sync(sync: Mapping[str, Any] | None) -> Figures | None:
    """Contacts with a target, how many each sense has missed, and the skews from content."""
    if sync is None:
        return None
    missed = {
        sense: None if told is None else told["missed"] for sense, told in sync["senses"].items()
    }
    return {"events": sync["events"], "missed": missed, "skew_ms": sync["skew_ms"]}


def usable_window(report: Mapping[str, Any], start_s: float) -> tuple[float, float] | None:
    """From when to when (s) of the session the orbit predicts a usable contact.

    The whole session where the radio is no contact with an orbit; None where it has none of it.
    """
    radio = report["gateways"]["ground"].get("radio", {})
    contact = radio.get("contact")
    if contact is None:
        return 0.0, report["seconds"]
    begin_s = max(0.0, contact["usable_from_s"] - start_s)
    end_s = min(report["seconds"], contact["usable_to_s"] - start_s)
    return (begin_s, end_s) if end_s > begin_s else None


def signal_s(report: Mapping[str, Any], begin_s: float, end_s: float) -> float:
    """For how long between two instants both ends heard each other: the lesser of the two."""
    heard = []
    for told in report["gateways"].values():
        windows = told.get("supervision", {}).get("contacts", ())
        total_ns = 0
        for window in windows:
            lost_ns = window["lost_ns"]
            last_ns = end_s * NS_PER_S if lost_ns is None else min(lost_ns, end_s * NS_PER_S)
            total_ns += max(0, last_ns - max(window["acquired_ns"], begin_s * NS_PER_S))
        heard.append(total_ns / NS_PER_S)
    return min(heard, default=0.0)


def _longest_pause_s(
    report: Mapping[str, Any],
    channels: Mapping[str, Mapping[str, Any]],
    window: tuple[float, float] | None,
) -> float:
    """The longest part of a pause in which there was a signal all the time, in the window."""
    if window is None:
        return 0.0
    longest_s = 0.0
    for name, channel in channels.items():
        # Where it ends, somebody hears the other end's gateway.
        end = "space" if name.startswith("up") else "ground"
        contacts = report["gateways"][end].get("supervision", {}).get("contacts", ())
        for begin_s, end_s in channel["pauses_s"]:
            for contact in contacts:
                lost_ns = contact["lost_ns"]
                last_s = report["seconds"] if lost_ns is None else lost_ns / NS_PER_S
                first_s = max(begin_s, contact["acquired_ns"] / NS_PER_S, window[0])
                longest_s = max(longest_s, min(end_s, last_s, window[1]) - first_s)
    return round(longest_s, 3)


def least_energy_uj(report: Mapping[str, Any]) -> float | None:
    """The least energy (µJ) that a passivity observer has seen; None if there is none."""
    places = (report["haptic"], report.get("processes", {}))
    return min((least for place in places for least in _values("least_uj", place)), default=None)


def _values(name: str, table: Mapping[str, Any]) -> Iterator[float]:
    for key, value in table.items():
        if isinstance(value, Mapping):
            yield from _values(name, value)
        elif key == name and value is not None:
            yield value


def faults(figures: Figures) -> list[str]:
    """What is wrong with a session, a word each; an empty list is a usable pass."""
    if "error" in figures:
        return ["crashed"]
    found = []
    predicted_s, usable_s = figures["predicted_s"], figures["usable_s"]
    if predicted_s is None or usable_s < USABLE_SHARE * predicted_s - _acquisition_s(figures):
        found.append("unusable")
    if any(figures["longest_pause_s"][kind] > most for kind, most in LONGEST_PAUSE_S.items()):
        found.append("stuck")
    least_uj = figures["least_energy_uj"]
    if least_uj is not None and least_uj < -ROUNDING_UJ:
        found.append("unstable")
    streams = figures["streams"].values()
    if any(of["cap_share"] > 1 or of["burst_share"] > BURST_SHARE for of in streams):
        found.append("over its cap")
    if figures["failures"]:
        found.append("failed")
    return found


def _acquisition_s(figures: Figures) -> float:
    """What finding each other may take at a session's begin, the light's way included."""
    if figures["predicted_s"] != figures["seconds"]:
        return 0.0
    return 0.1 + float(figures["longest_delay_s"])


#: Of the table of sessions. Lost: of all frames, with those before and after the usable time;
#: shown/s: pictures a second of signal; skew: video after force; hurt: damaged; cap: the largest
#: second of any stream, of its cap.
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


def table_rows(sessions: Mapping[int, Figures]) -> Iterator[tuple[str, ...]]:
    """The cells of each session, in the order of its seed."""
    for seed in sorted(sessions):
        yield (str(seed), *_cells(sessions[seed]))


def _cells(figures: Figures) -> tuple[str, ...]:
    verdict = ", ".join(faults(figures)) or "usable"
    if "error" in figures:
        return *[""] * (len(HEADINGS) - 2), verdict
    streams = figures["streams"]
    video, voice = streams.get("uplink_video"), streams.get("uplink_voice")
    skew, together = figures["skew_ms"].get("video_haptic"), figures["lip_sync"]
    least_uj, usable_s = figures["least_energy_uj"], figures["usable_s"]
    lost = [
        f"{100 * of['frames_lost'] / max(1, of['frames']):.2f}" for of in figures["frames"].values()
    ]
    return (
        "none" if usable_s is None else f"{usable_s:.1f} of {figures['predicted_s']:.1f}",
        str(max(figures["contacts"].values(), default=0)),
        " / ".join(lost),
        _latencies(figures["haptic"]["up"], "p99.9"),
        _latencies(video, "p50", "p99"),
        ""
        if video is None
        else f"{video['frames_displayed'] / max(1e-9, figures['signal_s']):.1f}",
        _latencies(voice, "p99"),
        "" if skew is None else f"{skew['p95']:.1f}",
        "" if together is None else f"{100 * together['within']:.2f}",
        ""
        if video is None
        else " / ".join(f"{video[f'{spell}_ms'] / 1000:.1f}" for spell in _SPELLS),
        f"{100 * max((of['cap_share'] for of in streams.values()), default=0):.1f}",
        "" if least_uj is None else f"{least_uj:g}",
        verdict,
    )


def _latencies(channel: Mapping[str, Any] | None, *names: str) -> str:
    """Nothing for a channel that carried nothing: its percentiles are none."""
    if channel is None or not channel["latency_ms"]["count"]:
        return ""
    return " / ".join(f"{channel['latency_ms'][name]:.1f}" for name in names)


def markdown(sessions: Mapping[int, Figures], title: str) -> str:
    """The table for a document."""
    lines = [title, "", _line(HEADINGS), "|" + "|".join(["--:"] * (len(HEADINGS) - 1)) + "|---|"]
    lines += [_line(row) for row in table_rows(sessions)]
    return "\n".join([*lines, "", summary(sessions), ""])


def _line(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cells) + " |"


def summary(sessions: Mapping[int, Figures]) -> str:
    """All sessions in a sentence."""
    usable = sum(not faults(figures) for figures in sessions.values())
    words: dict[str, int] = {}
    for figures in sessions.values():
        for word in faults(figures):
            words[word] = words.get(word, 0) + 1
    others = "".join(f", {count} {word}" for word, count in words.items())
    whole = [figures for figures in sessions.values() if "error" not in figures]
    videos = [figures["streams"].get("uplink_video") for figures in whole]
    worst = _each("p99", [video for video in videos if video is not None])
    force = _each("max", [figures["haptic"]["up"] for figures in whole])
    said = f"{usable} of {len(sessions)} sessions usable{others}."
    if force:
        said += f" Force at most {max(force):.1f} ms on its way."
    if worst:
        said += f" Video p99 from {min(worst):.1f} to {max(worst):.1f} ms."
    return said


def headlines(sessions: Mapping[int, Figures]) -> list[Headline]:
    """The figures of all sessions for the page of measurements."""
    whole = [figures for figures in sessions.values() if "error" not in figures]
    videos = [of["streams"]["uplink_video"] for of in whole if "uplink_video" in of["streams"]]
    usable = sum(not faults(figures) for figures in sessions.values())
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
        ("force, one way, largest", _each("max", [of["haptic"]["up"] for of in whole])),
        ("uplink picture, p99 of the worst session", _each("p99", videos)),
    ):
        if values:
            found.append(Headline(what=what, unit="ms", value=max(values)))
    least_uj = [of["least_energy_uj"] for of in whole if of["least_energy_uj"] is not None]
    if least_uj:
        what = "least energy that a passivity observer saw"
        found.append(Headline(what=what, unit="µJ", value=min(least_uj)))
    return found


def _each(name: str, channels: Sequence[Mapping[str, Any]]) -> list[float]:
    """A figure of the latencies of each channel that carried something."""
    spreads = [channel["latency_ms"] for channel in channels]
    return [spread[name] for spread in spreads if spread["count"]]
