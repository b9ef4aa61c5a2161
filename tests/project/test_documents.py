"""The documents' shape: who reads a page and why, what leads where, and how long all may be."""

import re

import pytest
from positions import ROOT
from user_tables import purpose

DOCS = ROOT / "docs"
PAGES = sorted(DOCS.glob("*.md"))
EXPERIMENTS = sorted((DOCS / "experiments").glob("*.md"))
FRONT = [ROOT / name for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md")]
#: With a letter or a digit each; signs of tables are none.
MOST_WORDS = 47_000
#: Of the README: what a screen or two show.
MOST_LINES = 100


@pytest.mark.parametrize("page", [*PAGES, *EXPERIMENTS], ids=lambda page: page.stem)
def test_a_page_names_its_reader_and_its_question_first(page):
    assert all(purpose(page.read_text(encoding="utf-8")))


@pytest.mark.parametrize("pages", [PAGES, EXPERIMENTS], ids=["docs", "experiments"])
def test_the_indexes_lead_to_every_page(pages):
    index = pages[0].parent / "index.md"
    linked = set(re.findall(r"\]\(([\w-]+\.md)", index.read_text(encoding="utf-8")))
    assert {page.name for page in pages} - linked - {index.name} == set()


@pytest.mark.parametrize("page", [*FRONT, *PAGES, *EXPERIMENTS], ids=lambda page: page.stem)
def test_every_fragment_of_a_link_is_a_heading(page):
    for name, fragment in re.findall(
        r"\]\(([\w./-]*)#([\w-]+)\)", page.read_text(encoding="utf-8")
    ):
        target = page.parent / name if name else page
        headings = re.findall(r"^#+ (.*)$", target.read_text(encoding="utf-8"), re.MULTILINE)
        anchors = {re.sub(r"[^\w -]", "", title.lower()).replace(" ", "-") for title in headings}
        assert fragment in anchors, f"{name}#{fragment}"


def test_all_documents_together_stay_short():
    texts = {page: page.read_text(encoding="utf-8") for page in (*FRONT, *PAGES, *EXPERIMENTS)}
    words = (word for text in texts.values() for word in text.split())
    assert sum(re.search(r"\w", word) is not None for word in words) <= MOST_WORDS
    assert texts[FRONT[0]].count("\n") <= MOST_LINES
