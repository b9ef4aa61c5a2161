"""The sums over all connections of partners outlive each of them."""

from pipelines.partner.partner_metrics import RtcStreamMetrics
from pipelines.partner.tally import ConnectionSeen, MediaMetrics, Tally, TrackMetrics

STREAMS = {"video": "rtc_video"}


def seen(packets, *, connected=True, restarts=0):
    track = TrackMetrics(packets=packets, octets=10 * packets, dropped=7)
    metrics = MediaMetrics(sent={"video": track}, received={}, garbage=1)
    return ConnectionSeen(connected, restarts, metrics, STREAMS)


def test_connections_that_ended_stay_in_the_sums():
    tally = Tally()
    tally.handle_connections({"a": ConnectionSeen(False, 0, None, STREAMS)})
    assert (tally.connections, tally.total.streams) == (0, {})
    tally.handle_connections({"a": seen(3)})
    tally.handle_connections({"a": seen(5, connected=False, restarts=1), "b": seen(2)})
    tally.handle_connections({"b": seen(4)})
    tally.handle_connections({})
    assert tally.connections == 2
    assert (tally.total.restarts, tally.total.garbage) == (1, 2)
    assert tally.total.streams == {"rtc_video": RtcStreamMetrics(packets=9, octets=90)}
