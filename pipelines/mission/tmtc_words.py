"""Telecommands from words, and what became of them in words: what `kontur-av tc` reads and says."""

from collections.abc import Sequence

from kontur_av.errors import ConfigError
from pipelines.mission.tmtc_messages import CommandUpdate, Reported, SendCommand
from telepresence.tmtc.pus.dictionary import Application
from telepresence.tmtc.pus.user import SUPERSEDED
from telepresence.tmtc.pus.values import Parameter, Value

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
    functions = {one.name: one for one in application.functions}
    if word in functions:
        parameters = application.named(functions[word].arguments)
        if len(parameters) != len(rest):
            needs = " ".join(one.name for one in parameters) or "nothing"
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


def selection_error(camera: str, update: CommandUpdate) -> str:
    """Why a camera is not selected."""
    if update.verified or update.stage == "refused":
        return update.reason
    if update.reason == SUPERSEDED:
        return f"select {camera}: {SUPERSEDED}"
    return f"select {camera}: no acknowledgement came"


def _tries(update: CommandUpdate) -> str:
    return f", sent {update.tries} times" if update.tries > 1 else ""


def report_words(report: Reported, application: Application) -> str:
    """A report in one line: each value with its unit."""
    units = {one.name: one.unit for one in application.parameters}
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
