"""The modules of the pages and of samples in Node.js, without a browser: each file is a test."""

import re
import shutil
import subprocess

import pytest
from positions import ROOT

HERE = ROOT / "tests" / "web"
STATIC = ROOT / "pipelines" / "seats" / "static"
FILES = sorted(HERE.glob("*.test.mjs"))
#: What makes elements, or imports for that alone.
MAKES_ELEMENTS = re.compile(
    r'\bcustomElements\b|createElement\(|from "\./dom\.js"|^import "', re.MULTILINE
)


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name.partition(".")[0])
def test_node_passes(path):
    if shutil.which("node") is None:
        pytest.skip("node: apt-get install nodejs (18 or later)")
    done = subprocess.run(
        ["node", "--no-warnings", "--test-reporter=spec", str(path)],
        capture_output=True,
        text=True,
        timeout=300,
        cwd=HERE,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert re.search(r"pass [1-9]", done.stdout), done.stdout


def imported(text):
    """The modules beside it that a module imports."""
    return set(re.findall(r'^import [^;]*"\./([\w.]+)";', text, re.MULTILINE))


def test_node_runs_each_module_that_needs_no_page():
    texts = {path.name: path.read_text(encoding="utf-8") for path in STATIC.glob("*.js")}
    code = {name: re.sub(r"/\*.*?\*/", "", text, flags=re.DOTALL) for name, text in texts.items()}
    types = {name for name, text in code.items() if text.strip() == "export {};"}
    pages = {name for name, text in code.items() if MAKES_ELEMENTS.search(text)}
    # What imports such a module needs a page, too.
    while more := {name for name in code if imported(code[name]) & pages} - pages:
        pages |= more
    named = re.compile(r'(?:load|begin)\("([\w.]+)"\)')
    run = {name for path in FILES for name in named.findall(path.read_text(encoding="utf-8"))}
    while more := {one for name in run for one in imported(code[name])} - run:
        run |= more
    lines = sum(texts[name].count("\n") for name in run)
    print(f"node runs {len(run)} of {len(texts)} modules, {lines} lines")
    assert set(code) - pages - types - run == set()
