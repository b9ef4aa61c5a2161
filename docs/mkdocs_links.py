"""For mkdocs: links out of docs/ become text, because the site has these pages only."""

import re
from typing import Any

_OUTSIDE = re.compile(r"(?<!!)\[([^\]]*)\]\(\.\./(?!experiments/|images/)[^)]*\)")
_UP_FROM_EXPERIMENTS = re.compile(r"(?<!!)\[([^\]]*)\]\(\.\./\.\./[^)]*\)")


def on_page_markdown(markdown: str, *, page: Any, **_: Any) -> str:
    """The page's Markdown; called by mkdocs for each page."""
    inner = "/" in page.file.src_uri
    return (_UP_FROM_EXPERIMENTS if inner else _OUTSIDE).sub(r"\1", markdown)
