"""What a session's launcher tells the recorder, the pages and a monitoring system. A core."""

import msgspec


class Event(msgspec.Struct, frozen=True, kw_only=True):
    """One event.

    number: from 1 on. at_us: on the session's clock. what: `link`, `process`, `camera`, `stale`,
    `joystick`, `input` or `session`.
    """

    number: int
    at_us: int
    what: str
    text: str


class SessionEvents(msgspec.Struct, frozen=True, kw_only=True):
    """What the recorder gets: events that it was not told yet, and figures at times.

    at_us: on the session's clock. figures: all, by name, as pages get them.
    """

    at_us: int
    events: list[Event]
    figures: dict[str, int | float | str | bool | None] = {}


class MonitoredSession(msgspec.Struct, frozen=True, kw_only=True):
    """What a monitoring system gets.

    report: JSON of the session's report so far. problems: what is wrong now, a line each.
    """

    report: msgspec.Raw
    problems: list[str]
