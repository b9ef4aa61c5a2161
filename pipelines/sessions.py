"""The sessions of this user on this machine: what they are called, and what the dead ones left."""

import os
import re
from pathlib import Path

from kontur_av.topics import remove_session, session_root


def new_session_name(setup: str) -> str:
    """A name for a session of the setup called `setup`; it ends with this launcher's process id."""
    readable = re.sub("[^a-z0-9]+", "-", setup.lower())[:16].strip("-")
    return f"{readable or 'session'}-{os.getpid()}"


def clear_dead_sessions() -> list[str]:
    """Remove what sessions whose launcher was killed have left; their names."""
    cleared = []
    everywhere = session_root("any").parent
    for directory in everywhere.glob("*-*") if everywhere.is_dir() else ():
        launcher = directory.name.rpartition("-")[2]
        if launcher.isdecimal() and not Path(f"/proc/{launcher}").exists():
            remove_session(directory.name)
            cleared.append(directory.name)
    return cleared
