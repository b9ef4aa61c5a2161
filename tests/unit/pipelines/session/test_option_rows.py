"""Options as rows of text."""

import argparse
from pathlib import Path

import pytest

from kontur_av.errors import ConfigError
from pipelines.cli import CommandParser
from pipelines.session.option_rows import add_actions, add_options


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


@pytest.mark.parametrize(
    ("words", "first", "second", "more", "rate"),
    [
        ("run DIR --rate 2 -- -q x", "DIR", "-q", ["x"], 2.0),
        ("run DIR -- --rate 3", "DIR", "--rate", ["3"], None),
        ("run DIR one --rate 2 two", "DIR", "one", ["two"], 2.0),
        ("run --rate 2 DIR one -3 --", "DIR", "one", ["-3"], 2.0),
        ("run DIR --rate 2", "DIR", None, [], 2.0),
    ],
)
def test_values_that_may_be_left_out_stand_before_and_behind_options(
    words, first, second, more, rate
) -> None:
    parser = CommandParser(prog="x")
    rows = ("first DIR", "second X <?>", "more WORD <...>", "--rate R <float>")
    add_actions(parser, {"run": ("runs it", *rows)})
    given = parser.parse_args(words.split())
    assert (given.first, given.second, given.more, given.rate) == (first, second, more, rate)
    with pytest.raises(ConfigError, match="unrecognized arguments: -z"):
        parser.parse_args(["run", "DIR", "-z"])
