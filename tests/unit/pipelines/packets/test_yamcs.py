"""What YAMCS is told of a session."""

import re

from pipelines.packets.yamcs import instance_files


def test_yamcs_takes_each_virtual_channel_of_both_ways():
    def links(frames_port):
        files = instance_files("", ("here", 5), udp=False, frames_port=frames_port, http_port=8090)
        return files["etc/yamcs.kontur_av.yaml"].split("  - name: session")[1]

    assert "UdpTmFrameLink" not in links(None)
    down, up = links(7).split("  - name: ")[1:]
    for text, values in (
        (down, {"port": ["7"], "spacecraftId": ["76"], "frameLength": ["500"], "vcId": ["1"]}),
        (up, {"port": ["8"], "frameLength": ["32"], "vcId": [str(one) for one in range(32)]}),
    ):
        for name, expected in values.items():
            assert re.findall(rf"{name}: (\w+)", text) == expected
