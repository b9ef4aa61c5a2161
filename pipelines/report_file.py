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
    """Write `report` whole or not at all."""
    partial = path.with_name(f".{path.name}.{secrets.token_hex(4)}")
    partial.write_text(json.dumps(report, indent=2) + "\n", encoding="utf-8")
    partial.replace(path)
