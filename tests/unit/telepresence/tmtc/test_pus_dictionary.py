"""The dictionary: mistakes are refused with one line, and others read our telemetry by its XTCE."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from pus_ends import Ends, S, oven_table

from kontur_av.errors import ConfigError
from telepresence.tmtc.pus.dictionary_file import (
    built_in_dictionary,
    dictionary_from_table,
    load_dictionary,
)
from telepresence.tmtc.pus.head import apid_of, destination_of, is_packet
from telepresence.tmtc.pus.packets import Telecommand, pack_packet

Spoil = Callable[[dict[str, Any]], Any]


@pytest.mark.parametrize(
    ("spoil", "line"),
    [
        (lambda t: t.clear(), "oven needs apid"),
        (lambda t: t.update(apid=0x101), "oven.apid is 257: choose one from 1 to 2046 that is not"),
        (lambda t: t.update(end="moon"), "oven.end is 'moon': choose one of space, ground"),
        (lambda t: t.update(evnet={}), "unknown field oven.evnet: the nearest one is oven.event"),
        (
            lambda t: t["parameter"]["lit"].update(type="boolean"),
            "oven.parameter.lit.type is 'boolean': choose one of u8,",
        ),
        (
            lambda t: t["parameter"]["lit"].update(number=2),
            "oven.parameter.lit.number is 2, as that of door: give each its own",
        ),
        (
            lambda t: t["parameter"]["lit"].update(scale="x"),
            "oven.parameter.lit: scale must be a number, not 'x'",
        ),
        (
            lambda t: t["parameter"]["lit"].update(unti="V"),
            "oven.parameter.lit: unknown field unti: the nearest one is unit",
        ),
        (
            lambda t: t["structure"]["light"].update(parameters=["lid"]),
            "oven.structure.light.parameters: parameter 'lid' is unknown: the nearest one is lit",
        ),
        (
            lambda t: t["structure"]["light"].update(parameters=["depth"] * 59),
            "oven.structure.light.parameters take 237 octets",
        ),
        (
            lambda t: t["structure"]["light"].update(interval_s=0),
            "oven.structure.light.interval_s is 0.0: choose 0.1 to 3600",
        ),
        (
            lambda t: t["event"]["cooled"].update(severity="fatal"),
            "oven.event.cooled.severity is 'fatal': choose one of info, low, medium, high",
        ),
        (
            lambda t: t["monitor"]["heat"].update(above="hot"),
            "oven.monitor.heat: event 'hot' is unknown: the nearest one is too_hot",
        ),
        (lambda t: t["monitor"]["heat"].update(low=1.0), "a limit and its event 'below' need"),
        (
            lambda t: t["monitor"]["heat"].update(low=220.5, below="cooled"),
            "oven.monitor.heat.low is 220.5: it must not be above high",
        ),
        (lambda t: t["monitor"]["heat"].update(repeat=256), "heat.repeat is 256: choose 1 to 255"),
        (
            lambda t: t["action"][0].update(function="heat"),
            "oven.action.too_hot.function is 'heat': choose one without arguments",
        ),
    ],
)
def test_a_mistake_is_refused_with_one_line(spoil: Spoil, line: str) -> None:
    table = oven_table()
    spoil(table["oven"])
    with pytest.raises(ConfigError) as caught:
        dictionary_from_table(table)
    assert line in str(caught.value)
    assert "\n" not in str(caught.value)


def test_limits_may_be_equal_and_counts_the_largest() -> None:
    table = oven_table()
    table["oven"]["monitor"]["heat"].update(low=220.0, below="cooled", repeat=255)
    (monitor,) = dictionary_from_table(table).application("oven").monitors
    assert (monitor.low, monitor.high, monitor.repeat) == (220.0, 220.0, 255)


def test_a_file_is_named_in_what_it_is_refused_for(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text("[oven]\napid = 1\n[oven.parameter.x]\nnumber = 0\ntype = 'u8'\n")
    with pytest.raises(ConfigError, match=r"mine.toml: oven.parameter.x.number is 0: choose"):
        load_dictionary(path)


def test_the_built_in_dictionary_keeps_clear_of_the_links_other_packets() -> None:
    applications = built_in_dictionary().applications
    assert {"joystick", "robot", "space_gateway", "ground_gateway"} <= {
        one.name for one in applications
    }
    assert all(one.apid >= 0x120 for one in applications)


def test_a_packets_head_tells_where_it_goes() -> None:
    ends = Ends()
    ends.oven.handle_event("cooled", 0)
    octets = ends.space.poll_transmit(1 * S)
    assert octets is not None
    assert is_packet(octets)
    assert apid_of(octets) == 0x200
    # A telecommand goes to its application, however long it is.
    command = Telecommand(apid=0x200, count=1, service=8, subtype=1, data=bytes(range(1, 21)))
    assert destination_of(pack_packet(command)) == 0
