"""A whole report of a session, of which a test says only what it is about."""

import json

from told import message
from virtual_link import VirtualLink

from pipelines.report.collector import Collector
from pipelines.report.model import SessionReport, from_json, to_json
from pipelines.report.session_report import build_report
from pipelines.session.setup.setup_file import BUILT_IN
from pipelines.table import topology_of
from telepresence.link.radio import load_radio

RADIO = load_radio("iss-pass")


def partial_report(told):
    """The report of `spacejustin` in which nothing happened, with what `told` has in JSON's form.

    Its streams are exactly those of `told`.
    """
    collector = Collector(topology_of(BUILT_IN["spacejustin"]))
    up, down = (RADIO.path(way, seed=1, epoch_ns=0) for way in ("uplink", "downlink"))
    link = VirtualLink(uplink_flows=(), downlink_flows=(), up=up, down=down)
    for end, gateway in (("ground", link.ground), ("space", link.space)):
        collector.handle_message(f"{end}_gateway", message(gateway.report(0)), 0)
    table = json.loads(to_json(build_report(collector, seconds=1.0, processes=())))
    for stream in set(table["streams"]) - set(told["streams"]):
        del table["streams"][stream]
    return from_json(json.dumps(_merged(table, told)), SessionReport)


def _merged(table, told):
    if isinstance(told, list):
        return [_merged(None, one) for one in told]
    if isinstance(told, dict):
        below = table if isinstance(table, dict) else {}
        return below | {key: _merged(below.get(key), value) for key, value in told.items()}
    # Counts and instants are whole numbers.
    return int(told) if isinstance(told, float) and told.is_integer() else told
