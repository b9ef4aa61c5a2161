"""What processes and the TM/TC end of their segment tell each other: one message a datagram.

A process sends requests to the end's socket; the end publishes news on its topic. Both are
MessagePack. A request with a `client` and an `id` may be repeated: it is carried out once. At the
end: telecommands from words, and what became of them in words, as `kontur-av tc` has them.
"""

from collections.abc import Mapping, Sequence
from dataclasses import fields
from types import MappingProxyType

import msgspec

from kontur_av.errors import ConfigError, refused
from pipelines.session.setup.segments import Segment
from pipelines.session.situation import Known
from pipelines.session.topic import Topic
from telepresence.malformed import MALFORMED
from telepresence.tmtc.k2aci import CLASSES, K2aciMessage
from telepresence.tmtc.pus.dictionary import Application
from telepresence.tmtc.pus.user import SUPERSEDED
from telepresence.tmtc.pus.values import Parameter, Value

MAX_REQUEST_OCTETS = 2048
#: Of news, but for long texts.
MAX_NEWS_OCTETS = 4096

Values = dict[str, Value]
FieldValue = str | int | tuple[int, ...]
Fields = dict[str, FieldValue]


class SetValues(msgspec.Struct, frozen=True, tag=True):
    """Parameters of an application of this end have these values now."""

    application: str
    values: Values


class RaiseEvent(msgspec.Struct, frozen=True, tag=True):
    """The event `event` of an application of this end happened."""

    application: str
    event: str


class SendCommand(msgspec.Struct, frozen=True, tag=True):
    """Send a telecommand to an application of either end.

    verb: what it asks for.

    | verb | name | else |
    |---|---|---|
    | call | function | arguments |
    | ping | | |
    | report, housekeeping_on, housekeeping_off | structure | |
    | parameters | | arguments: names of parameters |
    | set | | values |
    """

    client: str
    id: int
    application: str
    verb: str
    name: str = ""
    arguments: tuple[Value, ...] = ()
    values: Values = {}


class ForwardCommand(msgspec.Struct, frozen=True, tag=True):
    """Send a telecommand of another ground system, for `application`. packet: its octets.

    edition: as of `PusUser.forward`.
    """

    client: str
    id: int
    application: str
    packet: bytes
    edition: int = 0


class FunctionDone(msgspec.Struct, frozen=True, tag=True):
    """A function was carried out, or refused for a reason; answers `FunctionAsked`."""

    application: str
    token: int | None
    refusal: str = ""


class SendK2aci(msgspec.Struct, frozen=True, tag=True):
    """Send a message of K2ACI to the other end. kind: its class; fields: as `plain_fields`."""

    client: str
    id: int
    kind: str
    fields: Fields


TmtcRequest = SetValues | RaiseEvent | SendCommand | ForwardCommand | FunctionDone | SendK2aci


class AskSituation(msgspec.Struct, frozen=True, tag=True):
    """A terminal asks what this end knows of hand and robot."""


class SituationAnswer(msgspec.Struct, frozen=True, tag=True):
    """Answers `AskSituation`."""

    known: Known


class CommandUpdate(msgspec.Struct, frozen=True, tag=True, omit_defaults=True):
    """What became of a telecommand.

    stage: "taken" (by this end), "unacknowledged" (sent `tries` times, and nothing came back),
    "accepted", "started", "completed", "failed", or "refused" here, before it was sent. done:
    nothing follows. verified: the other end said so; without it nobody knows whether it was carried
    out. mistake: it was refused because the request itself is wrong.
    """

    client: str
    id: int
    application: str
    stage: str
    done: bool = False
    ok: bool = False
    verified: bool = False
    reason: str = ""
    round_trip_ms: float = 0.0
    tries: int = 0
    mistake: bool = False


class FunctionAsked(msgspec.Struct, frozen=True, tag=True):
    """Carry out a function of an application of this end, then send `FunctionDone`.

    token: None after an event: nobody waits for its result. origin: the end that asks.
    """

    application: str
    token: int | None
    function: str
    arguments: tuple[Value, ...] = ()
    origin: str = ""


class ParameterChanged(msgspec.Struct, frozen=True, tag=True):
    """A telecommand has set a parameter of an application of this end."""

    application: str
    name: str
    value: Value


class Reported(msgspec.Struct, frozen=True, tag=True):
    """Telemetry. kind: "housekeeping", "event", "parameters" or "alive"; "data": of a route.

    name: the structure or the event. severity: of an event. unix_ns: on the sender's clock.
    """

    kind: str
    application: str
    unix_ns: int
    name: str = ""
    severity: str = ""
    values: Values = {}


class K2aciArrived(msgspec.Struct, frozen=True, tag=True):
    """A message of the other end, once and in order. boot_id, number: the other end's."""

    boot_id: int
    number: int
    kind: str
    fields: Fields


class K2aciUpdate(msgspec.Struct, frozen=True, tag=True, omit_defaults=True):
    """What became of a message. state: "waiting", "delivered" or "refused" (see `reason`)."""

    client: str
    id: int
    state: str
    reason: str = ""
    round_trip_ms: float = 0.0


TmtcNews = CommandUpdate | FunctionAsked | ParameterChanged | Reported | K2aciArrived | K2aciUpdate

K2ACI_KINDS: Mapping[str, type[K2aciMessage]] = MappingProxyType(
    {one.__name__: one for one in CLASSES}
)
_REQUESTS: msgspec.msgpack.Decoder[TmtcRequest] = msgspec.msgpack.Decoder(TmtcRequest)


def pack_request(request: TmtcRequest) -> bytes:
    """Return a request as octets. ConfigError if they are more than a datagram may have."""
    octets = msgspec.msgpack.encode(request)
    if len(octets) > MAX_REQUEST_OCTETS:
        raise ConfigError(f"a request of {len(octets)} octets: give at most {MAX_REQUEST_OCTETS}")
    return octets


def unpack_request(octets: bytes) -> TmtcRequest | None:
    """Return what `pack_request` packed, or None for anything else."""
    if len(octets) > MAX_REQUEST_OCTETS:
        return None
    try:
        return _REQUESTS.decode(octets)
    except MALFORMED:
        return None


#: By segment: what its end of telecommands and telemetry has to say.
TMTC_TOPICS: Mapping[Segment, Topic[TmtcNews]] = {
    segment: Topic(
        f"tmtc/{segment.value}",
        TmtcNews,
        "reports, verification, what applications are asked for",
    )
    for segment in Segment
}


def plain_fields(message: K2aciMessage) -> Fields:
    """Return a message of K2ACI as plain values by name, for `SendK2aci` and `K2aciArrived`."""
    found: Fields = msgspec.to_builtins(message)
    return found


def k2aci_message(kind: str, given: Mapping[str, FieldValue]) -> K2aciMessage:
    """Return the message of K2ACI of these fields; ConfigError."""
    cls = K2ACI_KINDS.get(kind)
    if cls is None:
        raise ConfigError(f"K2ACI {kind!r} is unknown: choose one of {', '.join(K2ACI_KINDS)}")
    known = [field.name for field in fields(cls)]
    if unknown := set(given) - set(known):
        raise ConfigError(f"{kind} has no {', '.join(sorted(unknown))}: it has {', '.join(known)}")
    with refused(kind, msgspec.ValidationError):
        return msgspec.convert(given, cls)


#: In place of a function; each with its verb in `SendCommand`.
SHORT_VERBS = {
    "ping": "ping",
    "report": "report",
    "on": "housekeeping_on",
    "off": "housekeeping_off",
    "get": "parameters",
    "set": "set",
}
_WITH_NAME = ("report", "on", "off")


def command_from_words(
    application: Application, words: Sequence[str], *, client: str, number: int
) -> SendCommand:
    """Return the telecommand of words such as `halt`, `report state` or `set limit=3`.

    A function that is called like a short verb goes before it. Raises ConfigError for other
    words, and for names and values that the application does not have.
    """
    word, *rest = words
    functions = {function.name: function for function in application.functions}
    if word in functions:
        parameters = application.named(functions[word].arguments)
        if len(parameters) != len(rest):
            needs = " ".join(parameter.name for parameter in parameters) or "nothing"
            raise ConfigError(f"{application.name} {word} takes {needs}")
        arguments = tuple(
            value_from_word(one, text) for one, text in zip(parameters, rest, strict=True)
        )
        return SendCommand(client, number, application.name, "call", word, arguments)
    if word not in SHORT_VERBS:
        known = ", ".join([*functions, *SHORT_VERBS])
        raise ConfigError(f"{application.name} does not know {word!r}: choose one of {known}")
    verb = SHORT_VERBS[word]
    if word == "set":
        values = dict(_setting(application, text) for text in rest)
        if not values:
            raise ConfigError(f"set takes NAME=VALUE, for parameters of {application.name}")
        return SendCommand(client, number, application.name, verb, values=values)
    if word == "get":
        if not rest:
            raise ConfigError(f"get takes names of parameters of {application.name}")
        return SendCommand(client, number, application.name, verb, arguments=tuple(rest))
    if len(rest) != (word in _WITH_NAME):
        needs = "one name of a report" if word in _WITH_NAME else "nothing"
        raise ConfigError(f"{word} takes {needs}")
    return SendCommand(client, number, application.name, verb, "".join(rest))


def value_from_word(parameter: Parameter, word: str) -> Value:
    """Return the value that a word means; ConfigError."""
    if parameter.type in ("choice", "text"):
        return word
    if parameter.type == "bool":
        if word not in ("true", "false"):
            raise ConfigError(f"{parameter.name} is {word!r}: give true or false")
        return word == "true"
    try:
        return float(word)
    except ValueError:
        raise ConfigError(f"{parameter.name} is {word!r}: give a number") from None


def _setting(application: Application, text: str) -> tuple[str, Value]:
    name, equals, word = text.partition("=")
    parameters = {one.name: one for one in application.parameters if one.writable}
    if not equals or name not in parameters:
        known = ", ".join(parameters) or "none"
        raise ConfigError(
            f"{text!r}: give NAME=VALUE; {application.name} has these to set: {known}"
        )
    return name, value_from_word(parameters[name], word)


def update_words(update: CommandUpdate) -> str:
    """What became of a telecommand, in one line."""
    about = f"{update.application}: {update.stage}"
    if not update.done:
        return f"{about}{_tries(update)}"
    if update.ok:
        return f"{about} after {update.round_trip_ms:.0f} ms{_tries(update)}"
    if update.stage == "failed" and not update.verified:
        about = f"{update.application}: not verified"
    return f"{about}{_tries(update)}: {update.reason}"


def selection_error(about: str, update: CommandUpdate) -> str:
    """Why a telecommand to the selector failed. about: its words."""
    if update.verified or update.stage == "refused":
        return update.reason
    if update.reason == SUPERSEDED:
        return f"{about}: {SUPERSEDED}"
    return f"{about}: no acknowledgement came"


def _tries(update: CommandUpdate) -> str:
    return f", sent {update.tries} times" if update.tries > 1 else ""


def report_words(report: Reported, application: Application) -> str:
    """A report in one line: each value with its unit."""
    units = {parameter.name: parameter.unit for parameter in application.parameters}
    values = ", ".join(
        f"{name} {_value_words(value)} {units.get(name, '')}".rstrip()
        for name, value in report.values.items()
    )
    about = " ".join(word for word in (report.application, report.name or report.kind) if word)
    return f"{about}: {values}" if values else about


def _value_words(value: Value) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    return f"{value:.6g}" if isinstance(value, float) else str(value)
