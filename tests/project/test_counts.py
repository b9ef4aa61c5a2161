"""Counts that keep the project small."""

import re
from collections import Counter
from pathlib import Path

import pytest

import kontur_av

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("kontur_av", "telepresence", "pipelines")


def untyped_tables() -> int:
    """The number of `dict[str, Any]` in the three packages."""
    files = (file for package in PACKAGES for file in (ROOT / package).rglob("*.py"))
    return sum(file.read_text(encoding="utf-8").count("dict[str, Any]") for file in files)


def modules_in_the_root() -> int:
    """Modules that lie in the root of `pipelines`."""
    return len([path for path in (ROOT / "pipelines").glob("*.py") if path.name != "__init__.py"])


def lines_of_code(folder: str) -> int:
    """Lines of all Python files of a folder."""
    files = (ROOT / folder).rglob("*.py")
    return sum(len(file.read_text(encoding="utf-8").splitlines()) for file in files)


#: What is counted, how, and the largest allowed count.
COUNTS = (
    ("`dict[str, Any]` in the packages", untyped_tables, 7),
    ("modules in the root of pipelines", modules_in_the_root, 6),
    ("names that `import kontur_av` gives", lambda: len(kontur_av.__all__), 20),
    ("lines of benchmarks", lambda: lines_of_code("benchmarks"), 7000),
    ("lines of tests", lambda: lines_of_code("tests"), 69_000),
    ("lines of pipelines/bench", lambda: lines_of_code("pipelines/bench"), 3300),
    ("lines of pipelines/bench/video", lambda: lines_of_code("pipelines/bench/video"), 1300),
)


@pytest.mark.parametrize(("what", "count", "most"), COUNTS, ids=[what for what, *_ in COUNTS])
def test_no_count_is_too_large(what, count, most):
    assert count() <= most, what


def test_no_two_public_classes_have_one_name():
    files = (file for package in PACKAGES for file in (ROOT / package).rglob("*.py"))
    texts = (file.read_text(encoding="utf-8") for file in files)
    names = Counter(
        name for text in texts for name in re.findall(r"^class ([^\W_]\w*)", text, re.MULTILINE)
    )
    assert [name for name, count in names.items() if count > 1] == []
