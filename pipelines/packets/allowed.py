"""Which telecommands another ground system may send. A core."""

from collections.abc import Iterable
from dataclasses import dataclass

from kontur_av.errors import ConfigError
from telepresence.tmtc.pus.dictionary import Dictionary
from telepresence.tmtc.pus.packets import Telecommand

#: Questions, which change nothing: are you alive, one report, values of parameters.
_QUESTIONS = {(17, 1), (3, 27), (20, 1)}
_ALL = "all"


@dataclass(frozen=True, slots=True)
class AllowedCommands:
    """applications: by APID, all of whose telecommands are allowed. functions: APID and number."""

    applications: frozenset[int] = frozenset()
    functions: frozenset[tuple[int, int]] = frozenset()

    def allows(self, command: Telecommand) -> bool:
        """Whether `command` may be passed on. Questions always may."""
        message = (command.service, command.subtype)
        if message in _QUESTIONS or command.apid in self.applications:
            return True
        return message == (8, 1) and (command.apid, *command.data[:1]) in self.functions


def allowed_commands(words: Iterable[str], dictionary: Dictionary) -> AllowedCommands:
    """Return what APPLICATION, APPLICATION.FUNCTION or "all" allow; ConfigError."""
    applications: set[int] = set()
    functions: set[tuple[int, int]] = set()
    for word in words:
        name, dot, function = word.partition(".")
        if word == _ALL:
            applications.update(dictionary.by_apid)
            continue
        table = dictionary.application(name)
        if not dot:
            applications.add(table.apid)
            continue
        numbers = {one.name: one.number for one in table.functions}
        if function not in numbers:
            known = ", ".join(numbers) or "none"
            raise ConfigError(f"{name} has no function {function!r}: choose one of {known}")
        functions.add((table.apid, numbers[function]))
    return AllowedCommands(frozenset(applications), frozenset(functions))
