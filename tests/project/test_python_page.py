"""The generated parts of documents are up to date."""

import ast
import importlib
import importlib.util
import re
from functools import cache

import pytest
from positions import ROOT

import kontur_av

pytest.importorskip("griffe", reason="pip install -e '.[dev]'")


@cache
def generate():
    spec = importlib.util.spec_from_file_location("generate", ROOT / "docs" / "generate.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_pages_and_tables_of_the_documents_are_up_to_date():
    page = (ROOT / "docs" / "python.md").read_text(encoding="utf-8")
    assert page == generate().python_page(), "run: python docs/generate.py"
    blocks = generate().topology_blocks()
    found = set()
    for page in (ROOT / "docs").glob("*.md"):
        text = page.read_text(encoding="utf-8")
        assert text == generate().filled(text, blocks), f"{page.name}: run docs/generate.py"
        found |= set(re.findall(r"<!-- generated: ([\w ]+) -->", text))
    assert set(blocks) <= found


def test_every_exported_name_is_there_and_explained():
    for package in generate().PACKAGES:
        module = importlib.import_module(package)
        for name in module.__all__:
            assert getattr(module, name).__doc__, name


def test_former_names_warn_with_their_new_place():
    for home, names in kontur_av._MOVED.items():
        for name in names.split():
            with pytest.warns(DeprecationWarning, match=f"kontur_av.{name} is {home}.{name} now"):
                assert getattr(kontur_av, name) is getattr(importlib.import_module(home), name)


@pytest.mark.parametrize("sample", sorted((ROOT / "samples").rglob("*.py")), ids=lambda p: p.stem)
def test_samples_import_documented_names(sample):
    ours = ("kontur_av", "telepresence", "pipelines")
    for node in ast.walk(ast.parse(sample.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and str(node.module).partition(".")[0] in ours:
            assert node.module in generate().PACKAGES
            public = importlib.import_module(node.module).__all__
            assert {one.name for one in node.names} <= set(public), node.module
