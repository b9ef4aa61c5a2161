"""The errors that msgspec raises on malformed octets of a peer or of a file."""

from typing import Final

import msgspec

#: Its own errors, text that is not UTF-8, and values that are nested too deep.
MALFORMED: Final = (msgspec.MsgspecError, UnicodeError, RecursionError)
