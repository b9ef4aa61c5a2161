"""The documents link to each other and name existing files."""

import re

import pytest
from positions import ROOT

DOCS = ROOT / "docs"
PAGES = sorted(DOCS.glob("*.md"))


def test_the_indexes_lead_to_every_page():
    for index, pages in ((DOCS / "index.md", PAGES), *_experiments()):
        linked = set(re.findall(r"\]\(([\w-]+\.md)", index.read_text(encoding="utf-8")))
        assert {page.name for page in pages} - linked - {"index.md"} == set()


def _experiments():
    folder = DOCS / "experiments"
    return [(folder / "index.md", sorted(folder.glob("*.md")))]


@pytest.mark.parametrize("page", [*PAGES, *_experiments()[0][1]], ids=lambda page: page.stem)
def test_every_fragment_of_a_link_is_a_heading(page):
    for name, fragment in re.findall(
        r"\]\(([\w./-]*)#([\w-]+)\)", page.read_text(encoding="utf-8")
    ):
        target = page.parent / name if name else page
        headings = re.findall(r"^#+ (.*)$", target.read_text(encoding="utf-8"), re.MULTILINE)
        anchors = {re.sub(r"[^\w -]", "", title.lower()).replace(" ", "-") for title in headings}
        assert fragment in anchors, f"{name}#{fragment}"
