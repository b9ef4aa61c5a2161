"""What the mission's pages of a seat show and ask for: chat, telecommands, telemetry, the radio."""

from collections import deque
from collections.abc import Callable, Mapping
from math import isfinite

import msgspec
from msgspec.structs import asdict, replace

from kontur_av.clock import NS_PER_US
from pipelines.mission import tmtc_messages
from pipelines.seats import texts
from pipelines.seats.command_client import ChatLog, CommandClient
from pipelines.session.access import Role, chat_role, refusal
from pipelines.session.setup.segments import Segment
from telepresence.tmtc.pus.dictionary import Application, Dictionary, Monitor
from telepresence.tmtc.pus.values import Parameter, Value

_MOST_EVENTS = 100


def level_of(application: Application, parameter: Parameter, value: Value) -> texts.Level:
    """Return the colour of a value: "bad" beyond a monitor's limit, "warn" beyond its own.

    "good" within limits, "none" without any.
    """
    if isinstance(value, str | bool) or not isfinite(value):
        return "none"
    monitors = [monitor for monitor in application.monitors if monitor.parameter == parameter.name]
    level: texts.Level = "none"
    limits: list[tuple[texts.Level, float | None, float | None]] = [
        ("warn", parameter.low, parameter.high),
        *(("bad", monitor.low, monitor.high) for monitor in monitors),
    ]
    for words, low, high in limits:
        if (low is not None and value < low) or (high is not None and value > high):
            level = words
        elif level == "none" and (low, high) != (None, None):
            level = "good"
    return level


def application_texts(dictionary: Dictionary) -> tuple[texts.ApplicationText, ...]:
    """What a page must know of the applications once."""
    return tuple(_application_text(application) for application in dictionary.applications)


def _application_text(one: Application) -> texts.ApplicationText:
    limits = {monitor.parameter: monitor for monitor in one.monitors}
    said = msgspec.convert(one, texts.ApplicationText, from_attributes=True)
    return replace(
        said, parameters=tuple(_limited(each, limits.get(each.name)) for each in said.parameters)
    )


def _limited(one: texts.ParameterText, monitor: Monitor | None) -> texts.ParameterText:
    """A parameter without limits of its own has those of its monitor."""
    if monitor is None:
        return one
    low = monitor.low if one.low is None else one.low
    return replace(one, low=low, high=monitor.high if one.high is None else one.high)


class TelemetryLog:
    """Takes reports of both ends' applications. A core."""

    def __init__(self, dictionary: Dictionary) -> None:
        self._known = {
            (application.name, parameter.name): (application, parameter)
            for application in dictionary.applications
            for parameter in application.parameters
        }
        self._values: dict[tuple[str, str], tuple[Value, int]] = {}
        self._events: deque[texts.EventLine] = deque(maxlen=_MOST_EVENTS)
        self._number = 0

    @property
    def values_text(self) -> texts.ValuesText:
        rows = []
        for (name, parameter), (value, at_us) in self._values.items():
            if (name, parameter) in self._known:
                level, plain = level_of(*self._known[name, parameter], value), _plain(value)
                rows.append(
                    texts.ValueText(
                        application=name, name=parameter, value=plain, level=level, at_us=at_us
                    )
                )
        return texts.ValuesText(values=tuple(rows))

    @property
    def events_text(self) -> texts.EventsText:
        """All events that are kept, the oldest first."""
        return texts.EventsText(events=tuple(self._events))

    def handle_report(self, report: tmtc_messages.Reported, now_ns: int) -> None:
        """Housekeeping, parameters, an event, or an application that is alive."""
        now_us = now_ns // NS_PER_US
        for name, value in report.values.items():
            self._values[report.application, name] = value, now_us
        if report.kind in ("event", "alive"):
            self._number += 1
            self._events.append(
                texts.EventLine(
                    number=self._number,
                    at_us=now_us,
                    application=report.application,
                    name=report.name or report.kind,
                    severity=report.severity or "info",
                    values={name: _plain(value) for name, value in report.values.items()},
                )
            )


def _plain(value: Value) -> Value | None:
    """JSON has no NaN."""
    return None if isinstance(value, float) and not isfinite(value) else value


_PEER = {Segment.SPACE: "the ground", Segment.GROUND: "space"}


def radio_text(
    segment: Segment,
    *,
    hears: bool | None,
    heard: bool | None,
    unverified: int,
    connected: bool = True,
    obstacle: str = "",
) -> texts.RadioText:
    """Return what to say at an end.

    hears: good frames of the peer arrive here. heard: the peer said so of ours in its newest
    report. None: not known. unverified: telecommands in a row that nobody acknowledged.
    connected: the link is; then only both directions may be said to carry.
    obstacle: why an end does not begin the link; "" for none.
    """
    if obstacle:
        return texts.RadioText(level="bad", words=f"No link: {obstacle}.")
    peer = _PEER[segment]
    sent = f" The last {unverified} were not acknowledged." if unverified > 1 else ""
    if hears is False:
        words = f"Nothing arrives from {peer}: telecommands go out unacknowledged.{sent}"
        return texts.RadioText(level="bad", words=words)
    if hears and heard is False:
        words = f"{peer.capitalize()} does not hear us: telecommands do not arrive there.{sent}"
        return texts.RadioText(level="bad", words=words)
    if unverified:
        count = "telecommand was" if unverified == 1 else f"{unverified} telecommands were"
        return texts.RadioText(level="warn", words=f"The last {count} not acknowledged by {peer}.")
    if hears is None:
        return texts.RadioText(level="none", words="Nobody knows yet whether the radio carries.")
    if not connected:
        return texts.RadioText(level="bad", words="The link is not connected.")
    return texts.RadioText(level="good", words="Both directions carry.")


_SIGNAL_EVENTS = {"signal_acquired": True, "signal_lost": False}


class MissionClient:
    """The mission at one seat. A core.

    After each `handle_`, send `poll_transmit`'s requests to the end's socket and drain
    `next_event`. `poll_texts` returns what changed since its last call, whole, by kind: a page that
    joins gets `texts`, so that all pages of a seat show the same.

    client: names this process at the end, and is new in each of its starts.
    """

    def __init__(self, segment: Segment, dictionary: Dictionary, *, client: str) -> None:
        self._segment = segment
        # The end tells requests apart by client and number, whatever they are.
        self._chat = ChatLog(f"{client}.chat")
        self._commands = CommandClient(client)
        self._telemetry = TelemetryLog(dictionary)
        self._hears: bool | None = None
        self._heard: bool | None = None
        self._connected = True
        self._obstacle = ""
        self._makers: Mapping[str, Callable[[], msgspec.Struct]] = {
            "chat": lambda: self._chat.text,
            "commands": lambda: self._commands.text,
            "values": lambda: self._telemetry.values_text,
            "events": lambda: self._telemetry.events_text,
            "radio": lambda: radio_text(
                segment,
                hears=self._hears,
                heard=self._heard,
                unverified=self._commands.unverified,
                connected=self._connected,
                obstacle=self._obstacle,
            ),
        }
        #: By kind: what does not come from telemetry, as other processes tell it.
        self._shown: dict[str, msgspec.Struct] = {}
        self._changed = set(self._makers)
        self.texts: dict[str, str] = {}

    def handle_command(
        self, page: int, role: Role, asked: texts.CommandRequest, now_ns: int
    ) -> str | None:
        """A page asks for a telecommand; return why it may not. None: the answer comes later."""
        refused = refusal(role, self._segment, asked.deed)
        if refused:
            return refused
        if "" in asked.arguments:
            number = asked.arguments.index("") + 1
            return f"{asked.name}: argument {number} is empty: write a value into each field"
        self._commands.handle_request(page, asked, role.words, now_ns)
        self._changed.add("commands")
        return None

    def handle_chat(self, role: Role, said: texts.ChatRequest, now_ns: int) -> str:
        """A page writes a line; return why it is not sent, or ""."""
        refused = refusal(role, self._segment, "chat")
        if refused:
            return refused
        self._changed.add("chat")
        return self._chat.handle_said(chat_role(role, self._segment), said.text, now_ns)

    def handle_news(self, news: tmtc_messages.TmtcNews, now_ns: int) -> None:
        if isinstance(news, tmtc_messages.CommandUpdate):
            if self._commands.handle_update(news):
                self._changed |= {"commands", "radio"}
        elif isinstance(news, tmtc_messages.K2aciUpdate):
            if self._chat.handle_update(news):
                self._changed.add("chat")
        elif isinstance(news, tmtc_messages.K2aciArrived):
            if self._chat.handle_arrived(news, now_ns):
                self._changed.add("chat")
        elif isinstance(news, tmtc_messages.Reported) and news.kind != "data":
            self._telemetry.handle_report(news, now_ns)
            if news.application == f"{self._segment.peer.value}_gateway":
                # It says whether it hears us; its event is the quicker one.
                said = news.values.get("signal", _SIGNAL_EVENTS.get(news.name))
                self._heard = said if isinstance(said, bool) else self._heard
            self._changed |= {"values", "radio"}
            if news.kind != "housekeeping":
                self._changed.add("events")

    def handle_signal(self, hears: bool) -> None:
        """Whether good frames arrive at this end."""
        if hears != self._hears:
            self._hears = hears
            self._changed.add("radio")

    def handle_link(self, connected: bool) -> None:
        """Whether the link is connected."""
        if connected != self._connected:
            self._connected = connected
            self._changed.add("radio")

    def handle_obstacle(self, why: str) -> None:
        """Why an end does not begin the link, in words; "" if nothing is in the way."""
        if why != self._obstacle:
            self._obstacle = why
            self._changed.add("radio")

    def handle_shown(self, kind: str, text: msgspec.Struct) -> None:
        """What a process of the mission shows; pages get it as it is."""
        if self._shown.get(kind) != text:
            self._shown[kind] = text
            self._changed.add(kind)

    def poll_transmit(self, now_ns: int) -> tmtc_messages.TmtcRequest | None:
        return self._commands.poll_transmit(now_ns) or self._chat.poll_transmit(now_ns)

    def next_event(self) -> texts.Answered | None:
        return self._commands.next_event()

    def poll_texts(self) -> dict[str, str]:
        fresh = {}
        for kind in sorted(self._changed):
            maker = self._makers.get(kind)
            shown = {"kind": kind} | named(self._shown[kind]) if maker is None else maker()
            fresh[kind] = texts.pack_text(shown)
        self._changed.clear()
        self.texts |= fresh
        return fresh


def named(shown: msgspec.Struct) -> dict[str, object]:
    """Return the fields by name, in depth: topics carry them without their names."""
    return {name: _unnested(value) for name, value in asdict(shown).items()}


def _unnested(value: object) -> object:
    if isinstance(value, msgspec.Struct):
        return named(value)
    if isinstance(value, list | tuple):
        return [_unnested(one) for one in value]
    return value
