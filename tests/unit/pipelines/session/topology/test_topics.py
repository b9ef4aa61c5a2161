"""Every typed topic: samples are read back as they were, and anything else is refused."""

import pickle

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kontur_av.errors import ProtocolError
from kontur_av.streams.coded_unit import CodedUnit
from pipelines.hand.hand_topics import HAND_INPUT_TOPIC
from pipelines.media.following import SELECTED_TOPIC, Choice
from pipelines.session.setup.setup_file import BUILT_IN
from pipelines.session.topic_ends import ROBOT_TOPIC
from pipelines.table import topology_of
from telepresence.haptics.device.page import PageInput
from telepresence.world import WorldState

TOPOLOGY = topology_of(BUILT_IN["spacejustin"], recorder=True, tasks=True, trainer=True)
TOPICS = {str(row.name): row.name for row in TOPOLOGY.topics if row.name.type is not None}


@pytest.mark.parametrize("topic", TOPICS.values(), ids=TOPICS)
@given(data=st.data())
def test_octets_are_a_sample_or_refused(topic, data):
    octets = data.draw(st.binary(max_size=64))
    try:
        sample = topic.unpack(octets)
    except ProtocolError as error:
        assert str(topic) in str(error) or topic.type is CodedUnit
    else:
        assert topic.unpack(topic.pack(sample)) == sample or sample != sample
    assert topic.what and pickle.loads(pickle.dumps(topic)).type == topic.type


@pytest.mark.parametrize(
    ("topic", "sample"),
    [
        (SELECTED_TOPIC, Choice(1 << 60, "c" * 64)),
        (HAND_INPUT_TOPIC, PageInput(True, 0.5, -1.0, 3, 2**32 - 1, 2**63 - 1, 7, (0.1, -0.2))),
        (ROBOT_TOPIC, WorldState(1, 0.1, 0.2, 3.0, True, 1, 1, holds=True)),
    ],
)
def test_a_sample_is_read_back_as_it_was(topic, sample):
    assert topic.unpack(topic.pack(sample)) == sample


def test_a_scalar_of_numpy_is_a_number():
    state = WorldState(5, x_m=np.float64(0.25), contact=np.bool_(True)).dated()
    assert ROBOT_TOPIC.unpack(ROBOT_TOPIC.pack(state)) == WorldState(
        5, x_m=0.25, contact=True, contact_since_ns=5, touched_ns=5
    )
