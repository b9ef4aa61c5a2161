"""What sessions gave, over months: figures and events of their reports in one SQLite file.

Other programs may read it: the tables are `session`, `figure` and `event`, as `_SCHEMA` has them.
"""

import sqlite3
from collections.abc import Iterable, Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, NamedTuple

from kontur_av.closing import Closing
from kontur_av.errors import ConfigError
from pipelines.session.session_metrics import nested_values

#: "KAva", by which a file is known as an archive.
_APPLICATION = 0x4B417661
_SCHEMA = """
create table session (
    id integer primary key, sha256 text not null unique, written text not null, name text not null,
    setup text not null, seconds real not null, failures integer not null);
create table figure (
    session integer not null references session, key text not null, value real not null,
    primary key (key, session)) without rowid;
create table event (
    session integer not null references session, at_s real not null, what text not null);
create index event_of on event (session);
"""


class ArchivedSession(NamedTuple):
    """A row of `session`. written: of its report, UTC."""

    number: int
    written: str
    name: str
    setup: str
    seconds: float
    failures: int


class SessionArchive(Closing):
    """An archive of reports; the file is made if need be.

    Raises ConfigError for another kind of file, or one that cannot be written.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            self._base = sqlite3.connect(path)
            (kind,) = self._base.execute("pragma application_id").fetchone()
            (tables,) = self._base.execute("select count(*) from sqlite_master").fetchone()
            if tables and kind != _APPLICATION:
                raise ConfigError(f"{path}: another program's database; name another file")
            if not tables:
                self._base.executescript(
                    f"begin; pragma application_id = {_APPLICATION}; {_SCHEMA} commit;"
                )
        except sqlite3.Error as error:
            raise ConfigError(f"{path}: no archive ({error}); name another file") from None

    def add(
        self,
        *,
        sha256: str,
        written_ns: int,
        name: str,
        report: Mapping[str, Any],
        events: Iterable[tuple[float, str]],
    ) -> bool:
        """Keep a session, whole or not at all; False if its report is already here.

        written_ns: of the report, since 1970. report: as JSON. events: pairs of seconds since the
        start and text.
        """
        at = datetime.fromtimestamp(written_ns / 1e9, UTC).isoformat(timespec="seconds")
        about = (sha256, at, name, report["setup"], report["seconds"], len(report["failures"]))
        with self._base as base:
            cursor = base.execute(
                "insert or ignore into session (sha256, written, name, setup, seconds, failures) "
                "values (?, ?, ?, ?, ?, ?)",
                about,
            )
            if not cursor.rowcount:
                return False
            number = cursor.lastrowid
            # Lists and texts are left out.
            metrics = (
                (number, key, float(value))
                for key, value in nested_values(report)
                if isinstance(value, int | float)
            )
            base.executemany("insert into figure values (?, ?, ?)", metrics)
            base.executemany(
                "insert into event values (?, ?, ?)", ((number, *event) for event in events)
            )
        return True

    def sessions(self) -> list[ArchivedSession]:
        rows = self._base.execute(
            "select id, written, name, setup, seconds, failures from session order by written, id"
        )
        return [ArchivedSession(*row) for row in rows]

    def events(self) -> list[tuple[str, int, int]]:
        """Each kind of event: its text, how often it came, and in how many sessions."""
        return self._base.execute(
            "select what, count(*), count(distinct session) from event group by what "
            "order by count(*) desc, what"
        ).fetchall()

    def keys(self, pattern: str = "*") -> list[str]:
        """The figures whose keys match the shell pattern."""
        rows = self._base.execute(
            "select distinct key from figure where key glob ? order by key", (pattern,)
        )
        return [key for (key,) in rows]

    def trend(self, key: str) -> list[tuple[str, str, float]]:
        """A figure over all sessions that have it: written, name, value; oldest first."""
        return self._base.execute(
            "select written, name, value from figure join session on session.id = figure.session "
            "where key = ? order by written, id",
            (key,),
        ).fetchall()

    def close(self) -> None:
        self._base.close()
