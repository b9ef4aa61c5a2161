"""Checksums of files: CCSDS 727.0-B-5 clause 4.2.2 and annex F, and SHA-256."""

from binascii import crc32

import numpy as np

from telepresence.files.pdus import ChecksumType

#: Those that this end can check.
KNOWN_SUMS = (ChecksumType.CRC_32, ChecksumType.MODULAR, ChecksumType.NULL_CHECKSUM)


def file_sum(kind: int, octets: bytes | bytearray) -> bytes:
    """Return the four octets of a checksum of `KNOWN_SUMS`; KeyError for another."""
    if kind == ChecksumType.NULL_CHECKSUM:
        return bytes(4)
    if kind == ChecksumType.CRC_32:
        return crc32(octets).to_bytes(4, "big")
    if kind == ChecksumType.MODULAR:
        padded = bytes(octets) + bytes(-len(octets) % 4)
        words = np.frombuffer(padded, ">u4")
        return (int(words.sum(dtype=np.uint64)) & 0xFFFFFFFF).to_bytes(4, "big")
    raise KeyError(kind)
