"""Where a run's report goes."""

import json
import os
import secrets
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from kontur_av.errors import ConfigError


def check_writable(path: Path | None) -> None:
    """ConfigError when `path` cannot be written: after the run it would be too late."""
    if path is None:
        return
    directory = path.parent
    if path.is_dir() or not directory.is_dir() or not os.access(directory, os.W_OK):
        raise ConfigError(f"--report {path}: cannot be written; name a file in an open directory")


def write_report(path: Path, report: Mapping[str, Any]) -> None:
    """Write `report` whole or not at all; into a device, a FIFO or a link as it is.

    To put a file in the place of `/dev/null` would take it from every program of the machine.
    """
    text = json.dumps(report, indent=2) + "\n"
    if path.is_symlink() or (path.exists() and not path.is_file()):
        path.write_text(text, encoding="utf-8")
        return
    partial = path.with_name(f".{path.name}.{secrets.token_hex(4)}")
    partial.write_text(text, encoding="utf-8")
    partial.replace(path)
