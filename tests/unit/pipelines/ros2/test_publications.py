"""Names and octets of ROS 2 over zenoh."""

import pytest

from kontur_av.errors import ProtocolError
from pipelines.ros2.publications import Attachment, Endpoint, Node, RosQuality, gid_of

STRING = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"
TYPE = {"type": "std_msgs/msg/String", "type_hash": STRING}
CHATTER = Endpoint(topic="/robot/chatter", quality=RosQuality.SENSOR, **TYPE)
NODE = Node(domain=7, zenoh_id="a1b2", namespace="/ns", name="talker")


def test_key_expressions_and_attachments_are_those_of_rmw_zenoh():
    names = "%/%ns/talker"
    topic = f"%robot%chatter/std_msgs::msg::dds_::String_/{STRING}"
    assert NODE.key(CHATTER) == f"7/robot/chatter/std_msgs::msg::dds_::String_/{STRING}"
    assert NODE.token() == f"@ros2_lv/7/a1b2/0/0/NN/{names}"
    end = f"{names}/{topic}/2::,5:,:,:,,"
    assert NODE.publisher_token(3, CHATTER) == f"@ros2_lv/7/a1b2/0/3/MP/{end}"
    assert NODE.subscription_token(4, CHATTER) == f"@ros2_lv/7/a1b2/0/4/MS/{end}"
    assert NODE.subscribers(CHATTER) == "@ros2_lv/7/*/*/*/MS/*/*/*/%robot%chatter/**"
    assert (RosQuality.LATCHED.value, RosQuality.RELIABLE.value) == (":1:,1:,:,:,,", "::,10:,:,:,,")
    gid = bytes(range(16))
    octets = bytes.fromhex("0100000000000000 1500cd5b07000000 10") + gid
    assert Attachment(1, 0x075BCD0015, gid).pack() == octets
    assert Attachment.unpack(octets) == (1, 0x075BCD0015, gid)
    for wrong in (b"", octets[:-1], octets + b"\0", octets[:16] + b"\x0f" + gid):
        with pytest.raises(ProtocolError):
            Attachment.unpack(wrong)
    assert len(gid_of("one")) == 16 and gid_of("one") != gid_of("other")
