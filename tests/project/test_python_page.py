"""The generated parts of documents are up to date, and the links of docs/python.md work."""

import importlib
import importlib.util
import re
from functools import cache

import pytest
from positions import ROOT

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
    page = (ROOT / "docs" / "python.md").read_text(encoding="utf-8")
    headings = {generate().anchor(name) for name in re.findall(r"^#+ (.*)$", page, re.MULTILINE)}
    assert set(re.findall(r"\]\(#([\w-]+)\)", page)) <= headings
    blocks = generate().topology_blocks()
    found = set()
    for page in (ROOT / "docs").glob("*.md"):
        text = page.read_text(encoding="utf-8")
        assert text == generate().filled(text, blocks), f"{page.name}: run docs/generate.py"
        found |= set(re.findall(r"<!-- generated: ([\w ]+) -->", text))
    assert set(blocks) <= found


@pytest.mark.parametrize("package", ["kontur_av", "telepresence", "pipelines"])
def test_every_exported_name_is_there_and_explained(package):
    module = importlib.import_module(package)
    for name in getattr(module, "__all__", ()):
        assert getattr(module, name).__doc__, name
