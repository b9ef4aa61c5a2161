"""The documents link to each other and name existing files."""

import re

import pytest
from positions import ROOT

DOCS = ROOT / "docs"
PAGES = sorted(DOCS.glob("*.md"))
MOST_STEPS = 15


def test_the_python_of_the_readme_is_that_of_the_sample_and_the_index_leads_to_every_page():
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    blocks = re.findall(r"^```python\n(.*?)^```", readme, re.M | re.S)
    lines = [line.strip() for block in blocks for line in block.splitlines() if line]
    samples = ("send_numpy", "receive_numpy", "join_session")
    texts = [(ROOT / "samples" / f"{name}.py").read_text(encoding="utf-8") for name in samples]
    # What is called must be called so in the samples; arguments may differ.
    called = re.findall(r"(?:\bav|\bsession|\bend|\bone)\.(\w+)|(\w+)\(", "\n".join(lines))
    names = {first or second for first, second in called} - {"show", "print"}
    assert {name for name in names if not any(name in text for text in texts)} == set()
    for index, pages in ((DOCS / "index.md", PAGES), *_experiments()):
        linked = set(re.findall(r"\]\(([\w-]+\.md)", index.read_text(encoding="utf-8")))
        assert {page.name for page in pages} - linked - {"index.md"} == set()


def _experiments():
    folder = DOCS / "experiments"
    return [(folder / "index.md", sorted(folder.glob("*.md")))]


def test_each_walk_has_few_steps_and_names_files_that_exist():
    text = (DOCS / "architecture.md").read_text(encoding="utf-8")
    walks = re.findall(r"^## A walk: (.*?)\n(.*?)(?=^## )", text, re.MULTILINE | re.DOTALL)
    assert len(walks) == 3
    for title, steps in walks:
        numbers = [int(number) for number in re.findall(r"^(\d+)\. ", steps, re.MULTILINE)]
        assert numbers == list(range(1, len(numbers) + 1)), title
        assert 0 < len(numbers) <= MOST_STEPS, title
        files = re.findall(r"`([a-z_]+/[\w./]+\.py)`", steps)
        assert len(files) >= len(numbers) - 2, title
        assert [file for file in files if not (ROOT / file).exists()] == []
        # A class that a step names is defined in one of the three packages.
        for name in re.findall(r"`([A-Z]\w+)`", steps):
            assert _defined(name), f"{title}: {name}"


def _defined(name: str) -> bool:
    packages = (ROOT / package for package in ("kontur_av", "telepresence", "pipelines"))
    pattern = re.compile(rf"^class {name}\b", re.MULTILINE)
    return any(
        pattern.search(path.read_text(encoding="utf-8"))
        for package in packages
        for path in package.rglob("*.py")
    )


@pytest.mark.parametrize("page", [*PAGES, *_experiments()[0][1]], ids=lambda page: page.stem)
def test_every_fragment_of_a_link_is_a_heading(page):
    for name, fragment in re.findall(
        r"\]\(([\w./-]*)#([\w-]+)\)", page.read_text(encoding="utf-8")
    ):
        target = page.parent / name if name else page
        headings = re.findall(r"^#+ (.*)$", target.read_text(encoding="utf-8"), re.MULTILINE)
        anchors = {re.sub(r"[^\w -]", "", title.lower()).replace(" ", "-") for title in headings}
        assert fragment in anchors, f"{name}#{fragment}"
