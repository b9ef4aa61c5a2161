"""A batch of frames is read back as it was; anything else is refused."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from kontur_av.errors import ProtocolError
from pipelines.link.link_metrics import pack_frames, unpack_frames

INSTANTS = st.integers(-(2**63), 2**63 - 1)
BATCHES = st.lists(st.tuples(INSTANTS, st.binary(max_size=600)), max_size=40)


@given(BATCHES, st.data())
def test_frames_are_read_back_and_a_batch_that_is_cut_or_longer_is_refused(frames, data):
    whole = pack_frames(frames)
    assert unpack_frames(whole) == frames
    cuts = [whole[: data.draw(st.integers(0, len(whole) - 1))]] if frames else []
    for octets in (*cuts, whole + b"\0"):
        with pytest.raises(ProtocolError):
            unpack_frames(octets)
