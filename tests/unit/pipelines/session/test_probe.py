"""A process collects whole rows or none, reports each once, and counts lost ones."""

import pytest

from pipelines.media.media_metrics import DisplayMetrics
from pipelines.session.probe import FLUSH_NS, Message, Probe, Series
from pipelines.session.session_metrics import LatenessRow, ProbeMetrics, RxRow, ShownRow
from pipelines.session.session_switch import Order
from telepresence.haptics.haptic_metrics import PortMetrics, SamplesSent


def told(probe, now_ns):
    """The message that is reported now, with the rows of each series."""
    message = Message.unpack(probe.message.pack())
    probe.handle_told(now_ns, told=True)
    return message, [(one.kind, one.stream, one.rows()) for one in message.series]


def test_counters_are_repeated_and_rows_and_orders_are_sent_once():
    probe, video = Probe(), "uplink_video"
    metrics = {
        (SamplesSent, ""): SamplesSent(sent=4, left_out=0),
        (PortMetrics, ""): PortMetrics(credit_uj=-5, least_uj=7),
        (DisplayMetrics, video): DisplayMetrics(frames_displayed=1),
    }
    for (_, stream), each in metrics.items():
        probe.publish(each, stream)
    probe.series(RxRow).add(RxRow(1, -3))
    probe.series(ShownRow, video).add(ShownRow(7, 8, 9))
    probe.message.orders.append(Order.STOP)
    message, rows = told(probe, 0)
    assert (message.metrics, message.orders) == (metrics, [Order.STOP])
    assert rows == [(RxRow, "", [RxRow(1, -3)]), (ShownRow, video, [ShownRow(7, 8, 9)])]
    probe.series(RxRow).extend([RxRow(2, 4), RxRow(3, 5)])
    message, rows = told(probe, 1)
    assert (message.metrics, message.orders) == (metrics, [])
    assert rows == [(RxRow, "", [RxRow(2, 4), RxRow(3, 5)])]


def test_a_column_has_one_value_a_row_and_a_probe_is_due_twice_a_second():
    lateness = Series(LatenessRow)
    lateness.extend_column([3, 4])
    assert lateness.rows() == [LatenessRow(3), LatenessRow(4)]
    with pytest.raises(ValueError, match="2 values"):
        Series(RxRow).extend_column([3])
    probe = Probe()
    assert probe.due(0)
    probe.handle_told(0, told=True)
    assert not probe.due(FLUSH_NS - 1)
    assert probe.due(FLUSH_NS)


@pytest.mark.rule("4")
def test_rows_without_a_reader_are_kept_for_a_while_and_dropped_whole():
    probe = Probe()
    arrivals = probe.series(RxRow)
    arrivals.add(RxRow(1, 1))
    probe.message.orders.append(Order.STOP)
    probe.handle_told(0, told=False)
    message, rows = told(probe, 0)
    assert (message.orders, rows) == ([Order.STOP], [(RxRow, "", [RxRow(1, 1)])])
    for number in range(10_001):
        arrivals.add(RxRow(number, -number))
    probe.handle_told(1, told=False)
    arrivals.add(RxRow(5, -5))
    message, rows = told(probe, 2)
    assert rows == [(RxRow, "", [RxRow(5, -5)])]
    assert message.metrics[ProbeMetrics, ""].probe_values_dropped == 20_002
