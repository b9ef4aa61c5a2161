"""The stages of pictures, and pauses, collected from messages in any order."""

import pickle
from itertools import permutations

import pytest
from told import message

from kontur_av.clock import NS_PER_MS, NS_PER_S
from pipelines.report.collector import Collector
from pipelines.session.figures import (
    CodingRow,
    DecodedRow,
    RxRow,
    SampleReceivedRow,
    SampleSentRow,
    ShownRow,
    TxRow,
)
from pipelines.session.setup.setup_file import BUILT_IN
from pipelines.table import topology_of

SESSION = topology_of(BUILT_IN["spacejustin"])
PERIOD_MS = 40


def tell(collector, process, *rows, stream=""):
    """A message with rows of one type or of several; values in ms are converted to ns."""
    collector.handle_message(process, message(rows=rows, stream=stream), 10 * NS_PER_S)


def ns(*values_ms):
    return [value * NS_PER_MS for value in values_ms]


@pytest.mark.parametrize("order", list(permutations(range(3))))
def test_the_stages_of_a_picture_are_joined_in_any_order_of_messages(order):
    collector = Collector(SESSION)
    coding, sent, received, decoded, shown = [], [], [], [], []
    for number in range(3):
        captured = 1000 + PERIOD_MS * number
        at = [captured + step for step in (0, 4, 5, 11, 12, 46, 49, 50)]
        coding.append(CodingRow(number, *ns(at[1], at[2]), 240, 2))
        sent.append(TxRow(number, *ns(at[0], at[3], at[4])))
        received.append(RxRow(number, *ns(at[5])))
        decoded.append(DecodedRow(number, *ns(at[6])))
        shown.append(ShownRow(number, *ns(at[0], at[7])))
    messages = [
        ("uplink_video_send", [*coding, *sent], ""),
        ("uplink_video_receive", [*decoded, *received], ""),
        ("space_display", shown, "uplink_video"),
    ]
    for index in order:
        process, rows, stream = messages[index]
        tell(collector, process, *rows, stream=stream)
    way = collector.streams["uplink_video"].way
    # The first picture has no weight, because no picture came before it.
    assert way.pictures == 2
    parts = ("camera", "capture", "waiting", "encoding", "network", "decoding", "display", "total")
    found = [way.mean_ns(part) / NS_PER_MS for part in parts]
    assert found == [PERIOD_MS / 2, 4, 1, 6, 35, 3, 1, 50 + PERIOD_MS / 2]
    assert (way.octets_mean, way.packets_mean) == (240, 2)


def test_a_pause_of_the_camera_is_not_counted_as_a_period():
    collector = Collector(SESSION)
    tell(
        collector, "uplink_video_send", CodingRow(2, *ns(5000, 5000), 9, 1), TxRow(2, *ns(5000) * 3)
    )
    tell(collector, "uplink_video_receive", RxRow(2, *ns(5010)))
    tell(
        collector,
        "space_display",
        ShownRow(1, *ns(10, 20)),
        ShownRow(2, *ns(5000, 5020)),
        stream="uplink_video",
    )
    assert collector.streams["uplink_video"].way.pictures == 0


def test_pauses_are_kept_with_begin_and_end():
    collector = Collector(SESSION)
    shown = [
        ShownRow(number, *ns(at - 40, at)) for number, at in enumerate((100, 1100, 2101, 2140))
    ]
    tell(collector, "space_display", *shown[:2], stream="uplink_video")
    tell(collector, "space_display", *shown[2:], stream="uplink_video")
    assert list(collector.streams["uplink_video"].pauses.ended_ns) == [tuple(ns(1100, 2101))]
    felt = [
        SampleReceivedRow(number, *ns(at)) for number, at in enumerate((1, 2, 202, 403, 404, 900))
    ]
    tell(collector, "joystick", *felt[:3])
    tell(collector, "joystick", *felt[3:])
    pauses = [tuple(ns(202, 403)), tuple(ns(404, 900))]
    assert list(collector.haptics["up"].pauses.ended_ns) == pauses
    assert not collector.haptics["down"].pauses.ended_ns


def test_the_figures_of_a_longer_session_take_no_more_memory():
    collector, sizes = Collector(SESSION), {}
    for second in range(120):
        begin_ns = second * NS_PER_S
        sent = [((1000 * second + k) % 65_536, begin_ns + k * NS_PER_MS) for k in range(1000)]
        felt = [SampleReceivedRow(number, at + 3 * NS_PER_MS) for number, at in sent]
        shown = [ShownRow(at // NS_PER_MS, at, at + 50 * NS_PER_MS) for _, at in sent[::20]]
        for process, rows, stream in (
            ("robot", [SampleSentRow(*row) for row in sent], ""),
            ("joystick", felt, ""),
            ("space_display", shown, "uplink_video"),
        ):
            told = message(rows=rows, stream=stream)
            collector.handle_message(process, told, begin_ns + NS_PER_S)
        sizes[second] = len(pickle.dumps((collector.streams, collector.haptics, collector.skews)))
    assert collector.haptics["up"].latency.count >= 119_000
    assert sizes[119] < 1.02 * sizes[59]
