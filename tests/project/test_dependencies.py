"""What is shipped names the versions that it runs with."""

import tomllib
from importlib.metadata import version
from pathlib import Path

import pytest
from packaging.requirements import Requirement

ROOT = Path(__file__).resolve().parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
RUNTIME = [Requirement(text) for text in PROJECT["dependencies"]]


@pytest.mark.parametrize("required", RUNTIME, ids=lambda one: one.name)
def test_a_runtime_dependency_has_both_bounds_and_is_within_them(required):
    assert {one.operator for one in required.specifier} == {">=", "<"}, required
    assert required.specifier.contains(version(required.name))


@pytest.mark.parametrize("required", RUNTIME, ids=lambda one: one.name)
def test_a_runtime_dependency_has_its_reason_above_it(required):
    before = (ROOT / "pyproject.toml").read_text().partition(f'    "{required.name}>=')[0]
    assert before.splitlines()[-1].startswith("    # ")
