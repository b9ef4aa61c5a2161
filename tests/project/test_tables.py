"""Each rule has a test, each option of each command too; the two tables say which."""

import pytest
from positions import ROOT

from tests import tables


@pytest.mark.parametrize("path", tables.TABLES, ids=lambda path: path.name)
def test_a_table_is_current(path):
    assert path.read_text(encoding="utf-8") == tables.TABLES[path](), "python tests/tables.py"


def test_each_rule_command_and_option_has_a_test():
    assert set(tables.rules()) == set(tables.tests_of_rules())
    assert [command for command, files in tables.tests_of_commands().items() if not files] == []
    assert [option for option, (_, files) in tables.tests_of_options().items() if not files] == []


@pytest.mark.parametrize("package", ["kontur_av", "telepresence", "pipelines", "benchmarks"])
def test_a_unit_test_lies_where_its_module_lies(package):
    """tests/unit/pkg/room/test_x.py tests pkg/room/x.py, or the package x."""
    room = ROOT / "tests" / "unit"
    guesses = {
        file: ROOT / file.relative_to(room).with_name(file.stem.removeprefix("test_"))
        for file in (room / package).rglob("test_*.py")
    }
    lost = (f for f, at in guesses.items() if not (at.is_dir() or at.with_suffix(".py").exists()))
    assert [str(file) for file in lost] == []
