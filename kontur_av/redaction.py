"""Hides passwords of addresses, however they are spelt, in all that people and files get to see."""

import re

#: Where an address begins: `scheme://`, also with a slash missing where the scheme is well known.
_BEGIN = re.compile(
    r"(?<![a-z0-9])(?:[a-z][a-z0-9+.-]*:(?=[/\\]{2})|(?:rtsp[a-z]*|rtmps?|https?|srt|rtp):(?=\S))"
    r"[/\\]*",
    re.IGNORECASE,
)
_AT = re.compile("@|%40")
#: Behind one of these may be a password, so what follows a later @ need not be a host.
_UNSURE = re.compile("[?#;=&].*(?:@|%40)", re.DOTALL)
#: All that is shown of an address: host, port, and a path of plain names.
_PLAIN = re.compile(
    r"(?:\[[0-9a-f:.]*\]|[\w.-]*)(?::(?:\d{1,5}|PORT)(?=/|$))?(?:/[\w./+,~-]*)?", re.IGNORECASE
)
_HIDDEN = "…"
#: An address in a sentence: to the quote that closes it, or to the next space.
_QUOTE = re.compile(r"""(['"`])[^\s'"`]*$""")
_ENDS = {quote: re.compile(rf"(?:\\.|[^{quote}])*", re.DOTALL) for quote in "'\"`"}
_WORD = re.compile(r"\S*?(?=[:,.)]*(?:\s|$))")


def shown_spec(spec: str) -> str:
    """Return a SPEC or an argument as it may be shown: an address without user, password, query."""
    begin = _BEGIN.search(spec)
    return spec if begin is None else spec[: begin.end()] + _shown(spec[begin.end() :])


def redacted(text: str) -> str:
    """Return a sentence without what may be a password of an address in it."""
    begin = _BEGIN.search(text)
    if begin is None:
        return text
    first = begin.end()
    user = max((at.end() for at in _AT.finditer(text, first)), default=first)
    quote = _QUOTE.search(text[: begin.start()])
    end = (_ENDS[quote[1]] if quote else _WORD).match(text, user)
    last = end.end() if end else len(text)
    return text[:first] + _shown(text[first:last]) + redacted(text[last:])


def _shown(address: str) -> str:
    """What may be shown of an address behind its scheme."""
    if _UNSURE.search(address):
        return _HIDDEN
    host = _AT.split(address)[-1]
    plain = _PLAIN.match(host)
    kept = plain[0] if plain else ""
    return kept if kept == host else f"{kept}{_HIDDEN}"
