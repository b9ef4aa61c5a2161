"""Parses a user's XML: what is not well-formed is refused by one line that names its place."""

from xml.parsers.expat import ErrorString, ExpatError, XMLParserType

from kontur_av.errors import ConfigError


def parse_xml(parser: XMLParserType, octets: bytes) -> None:
    """Hand a whole file to a parser with its handlers. Raises ConfigError."""
    try:
        parser.Parse(octets, True)
    except ExpatError as error:
        what = ErrorString(error.code)
        raise ConfigError(f"line {error.lineno}: no well-formed XML: {what}") from None
    except (ValueError, LookupError) as error:
        # An encoding that the parser does not know, or text that is not in the declared one.
        raise ConfigError(f"no XML in UTF-8: {error}") from None
