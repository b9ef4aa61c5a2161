"""Options as rows of text."""

import argparse
from pathlib import Path

import pytest

from kontur_av.errors import ConfigError
from pipelines.cli import CommandParser
from pipelines.session.option_rows import add_options


def _parser() -> argparse.ArgumentParser:
    parser = CommandParser(prog="x")
    add_options(
        parser,
        "file FILE <Path>  what to read",
        "count N <int?=3>  how often",
        "--rate K, M <float!>  in kbit/s",
        "--codec <h264|h265=h264>  of pictures",
        "--source NAME=SPEC <*>  an input",
        "--page [HOST:]PORT <?=8080>  where",
        "-q, --quiet  be quiet",
    )
    return parser


def test_rows_become_typed_options_with_their_defaults_and_are_checked() -> None:
    given = _parser().parse_args(
        ["a", "--rate", "1.5", "--source", "x=y", "--source", "z", "--page"]
    )
    assert vars(given) == {
        "file": Path("a"),
        "count": 3,
        "rate": 1.5,
        "codec": "h264",
        "source": ["x=y", "z"],
        "page": "8080",
        "quiet": False,
    }
    assert "--rate K, M " in _parser().format_help()

    for words in (["a"], ["a", "--rate", "1", "--codec", "vp8"]):
        with pytest.raises(ConfigError):
            _parser().parse_args(words)
