"""The joystick's log: a line for each change of its state, to be fetched later. A core."""

from collections.abc import Iterator
from typing import Final, Literal

import numpy as np

from kontur_av.clock import NS_PER_S
from pipelines.hand.hand_topics import JoystickStatus
from telepresence.haptics.device.states import JoystickState

#: Where the logs lie in the directory of space.
LOG_FOLDER: Final = "log"
#: Files that are kept, and when a new one begins: far below the longest file of the link.
KEPT_FILES: Final = 20
MOST_OCTETS: Final = 1 << 20
#: The temperature is told this often.
_WARM_NS = 60 * NS_PER_S


def log_name(unix_ns: int) -> str:
    """The name of a log that begins at this instant of Unix time; names sort by it."""
    return f"joystick-{_utc(unix_ns, 's')}.txt".replace(":", "")


class JoystickLog:
    """Hand it each state of the joystick; a line has its UTC first."""

    def __init__(self) -> None:
        self._before: JoystickStatus | None = None
        self._warm_ns = 0

    def handle_status(self, status: JoystickStatus, unix_ns: int) -> list[str]:
        """Return the lines of what has changed, each with its end."""
        found = [*_changes(self._before, status)]
        if status.temperature_c is not None and unix_ns >= self._warm_ns:
            self._warm_ns = unix_ns + _WARM_NS
            found.append(f"motors at {status.temperature_c:.1f} °C")
        self._before = status
        return [f"{_utc(unix_ns, 'ms')} {words}\n" for words in found]


def _changes(before: JoystickStatus | None, now: JoystickStatus) -> Iterator[str]:
    if before is None:
        size = f"{200 * now.half_width_m:.0f} x {200 * now.half_height_m:.0f} cm"
        yield f"begins: {now.device}, workspace {size}, force limit {now.force_limit_n:g} N"
    state = JoystickState(now.state).words
    if before is None or (before.state, before.reason) != (now.state, now.reason):
        yield f"{state}: {now.reason}" if now.reason else state
    if before is None:
        return
    if now.experiment != before.experiment:
        yield f"next application: {now.experiment}"
    if now.dead_man != before.dead_man:
        yield f"dead-man button {'pressed' if now.dead_man else 'released'}"
    if now.robot_stopped != before.robot_stopped:
        yield f"emergency stop {'holds' if now.robot_stopped else 'released'}"
    if (now.test_number, now.test) != (before.test_number, before.test):
        figures = ", ".join(
            f"{name} {value:.4g}" for name, value in now.test_metrics.items() if value is not None
        )
        words = " ".join(word for word in (now.test_reason, figures) if word)
        yield f"functional test {now.test}: {words}" if words else f"functional test {now.test}"
    for by, number, refusal, earlier in (
        ("a person's command", now.answered, now.refusal, before.answered),
        ("a telecommand", now.commanded, now.command_refusal, before.commanded),
    ):
        if number != earlier and number is not None:
            yield f"{by} was {f'refused: {refusal}' if refusal else 'carried out'}"


def _utc(unix_ns: int, unit: Literal["s", "ms"]) -> str:
    return f"{np.datetime_as_string(np.datetime64(unix_ns, 'ns'), unit)}Z"
