"""The format of our recordings: its version, and what is in a compressed chunk. A core."""

from typing import Final

import lz4.frame
import zstandard

#: Files of a newer one are refused.
FORMAT = 1
#: Every channel's metadata has it under this key.
FORMAT_KEY = "kontur-av format"


#: A chunk that claims more is not unpacked, so that no file makes a process grow without bound.
MOST_CHUNK_OCTETS: Final = 1 << 28


def unpacked_chunk(compression: str, packed: bytes | memoryview, size: int) -> bytes | None:
    """Return the `size` octets in a chunk of an MCAP file, never more.

    None if it has another size, or is damaged.
    """
    if size > MOST_CHUNK_OCTETS:
        return None
    try:
        if compression == "zstd":
            known = zstandard.get_frame_parameters(packed).content_size
            if known not in (size, zstandard.CONTENTSIZE_UNKNOWN):
                return None
            plain = zstandard.ZstdDecompressor().decompress(packed, max_output_size=size)
        elif compression == "lz4":
            plain = lz4.frame.LZ4FrameDecompressor().decompress(packed, max_length=size + 1)
        elif compression:
            return None
        else:
            plain = bytes(packed)
    except (zstandard.ZstdError, RuntimeError, MemoryError):
        return None
    return plain if len(plain) == size else None
