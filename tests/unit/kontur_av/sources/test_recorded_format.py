"""A chunk of a recording is unpacked to the size that it names, and no further."""

import tracemalloc

import lz4.frame
import pytest
import zstandard
from hypothesis import given
from hypothesis import strategies as st

from kontur_av.sources.recorded_format import MOST_CHUNK_OCTETS, unpacked_chunk

PACK = {"": bytes, "lz4": lz4.frame.compress, "zstd": zstandard.compress}
UNSIZED = {
    "lz4": lambda plain: lz4.frame.compress(plain, store_size=False),
    "zstd": zstandard.ZstdCompressor(write_content_size=False).compress,
}


@given(st.binary(max_size=200), st.sampled_from([*PACK]), st.integers(-3, 3))
def test_a_chunk_is_unpacked_if_it_has_the_size_that_it_names(plain, compression, more):
    packed = PACK[compression](plain)
    found = unpacked_chunk(compression, packed, max(0, len(plain) + more))
    assert found == (plain if len(plain) == max(0, len(plain) + more) else None)


@given(st.binary(max_size=100), st.sampled_from(["lz4", "zstd", "gzip"]))
def test_anything_else_is_no_chunk(packed, compression):
    assert unpacked_chunk(compression, packed, 7) is None


@pytest.mark.parametrize("pack", [PACK["lz4"], PACK["zstd"], *UNSIZED.values()])
@pytest.mark.parametrize("told", [100, 1 << 60])
def test_a_chunk_that_is_longer_than_it_says_costs_no_memory(pack, told):
    compression = "zstd" if pack in (PACK["zstd"], UNSIZED["zstd"]) else "lz4"
    packed = pack(bytes(1 << 24))
    tracemalloc.start()
    assert unpacked_chunk(compression, packed, told) is None
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 1 << 20 < MOST_CHUNK_OCTETS
