"""space_packet_parser of LASP, which knows the XTCE document and nothing else of this project."""

import warnings
from io import BytesIO
from pathlib import Path
from typing import Any

import pytest

from telepresence.tmtc.pus.dictionary import Dictionary
from telepresence.tmtc.pus.xtce import dictionary_xtce


def decoded(dictionary: Dictionary, stream: bytes, directory: Path) -> list[Any]:
    """What the decoder finds in a stream of packets, by the XTCE of `dictionary`."""
    why = "space_packet_parser: pip install 'kontur-av[full]'"
    xtce = pytest.importorskip("space_packet_parser.xtce.definitions", reason=why)
    generators = pytest.importorskip("space_packet_parser.generators.ccsds", reason=why)
    document = directory / "dictionary.xml"
    document.write_text(dictionary_xtce(dictionary), encoding="utf-8")
    definition = xtce.XtcePacketDefinition.from_xtce(document)
    with warnings.catch_warnings():
        # It warns of octets that a definition leaves over.
        warnings.simplefilter("error")
        return [
            definition.parse_bytes(octets) for octets in generators.ccsds_generator(BytesIO(stream))
        ]
