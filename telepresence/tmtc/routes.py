"""Routes of telemetry: which data of an application go to components, or to ground. A core.

An XML file says so, and no component's code (Stelzer et al., 2017, section 5):

    <Routes>
      <Route from="battery" data="voltage charge" to="ground" period_s="2"/>
      <Route from="joystick" data="temperature" to="battery"/>
    </Routes>

`from`: any application of the dictionary. `to`: `ground`, as housekeeping every `period_s`, or a
component, which gets the data by `handle_data`. A component that a file names in `from` reports
what its routes send to ground, in place of its own reports.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from difflib import get_close_matches
from typing import Final
from xml.parsers import expat

from kontur_av.errors import ConfigError
from telepresence.tmtc.pus.dictionary import Application, Dictionary, Structure
from telepresence.tmtc.telemetry_source import MOST_HOUSEKEEPING_BPS, housekeeping_bps
from telepresence.xml_file import parse_xml

TO_GROUND: Final = "ground"
MAX_FILE_OCTETS: Final = 1 << 16
#: How often data go to a component, as far as they come that often.
PERIOD_S: Final = 0.5
_ROOT, _ROUTE = "Routes", "Route"
_KEYS: Final = ("from", "data", "to", "period_s")


@dataclass(frozen=True, slots=True, kw_only=True)
class TelemetryRoute:
    """source: an application. data: names of its parameters. to: `TO_GROUND`, or a component."""

    source: str
    data: tuple[str, ...]
    to: str
    period_s: float = 10.0


def read_routes(octets: bytes) -> tuple[TelemetryRoute, ...]:
    """Return the routes of an XML file; ConfigError, with the line and the fix."""
    if len(octets) > MAX_FILE_OCTETS:
        raise ConfigError(f"{len(octets)} octets: a file of routes has at most {MAX_FILE_OCTETS}")
    found: list[TelemetryRoute] = []
    parser = expat.ParserCreate()
    depth = 0

    def mistake(text: str) -> ConfigError:
        return ConfigError(f"line {parser.CurrentLineNumber}: {text}")

    def start(element: str, attributes: dict[str, str]) -> None:
        nonlocal depth
        depth += 1
        if depth > 2 or element != (_ROOT, _ROUTE)[depth - 1]:
            raise mistake(f"<{element}> here: write <{_ROUTE} .../> in <{_ROOT}>")
        if depth == 2:
            found.append(_route(attributes, mistake))

    def end(_element: str) -> None:
        nonlocal depth
        depth -= 1

    def document_type(*_: object) -> None:
        raise mistake("a document type is not allowed: leave out <!DOCTYPE ...>")

    parser.StartElementHandler, parser.EndElementHandler = start, end
    parser.StartDoctypeDeclHandler = document_type
    parse_xml(parser, octets)
    return tuple(found)


def _route(attributes: dict[str, str], mistake: Callable[[str], ConfigError]) -> TelemetryRoute:
    for key in attributes:
        if key not in _KEYS:
            (near,) = get_close_matches(key, _KEYS, n=1, cutoff=0.0)
            raise mistake(f"unknown attribute {key}: the nearest one is {near}")
    for key in _KEYS[:3]:
        if not attributes.get(key, "").strip():
            raise mistake(f'<{_ROUTE}> needs {key}="..."')
    data, to = tuple(dict.fromkeys(attributes["data"].split())), attributes["to"].strip()
    route = TelemetryRoute(source=attributes["from"].strip(), data=data, to=to)
    period = attributes.get("period_s")
    if period is None:
        return route
    try:
        period_s = float(period)
    except ValueError:
        period_s = 0.0
    if to != TO_GROUND or not 0.1 <= period_s <= 3600:
        raise mistake(f'period_s="{period}": 0.1 to 3600 s, of a route to {TO_GROUND}')
    return replace(route, period_s=period_s)


def with_routes(
    dictionary: Dictionary, routes: Sequence[TelemetryRoute], components: Iterable[str]
) -> Dictionary:
    """Return the dictionary with the reports that routes need. components: their names.

    What goes from an application in space to a component goes down as housekeeping, too.
    ConfigError for an application, data or a component that there is none of.
    """
    names = set(components)
    for route in routes:
        table = dictionary.application(route.source)
        known = [parameter.name for parameter in table.parameters]
        for name in route.data:
            if name not in known:
                near = get_close_matches(name, known, n=1, cutoff=0.0)
                fix = f"the nearest one is {near[0]}" if near else "it has none"
                raise ConfigError(f"route from {route.source}: data {name!r} is unknown: {fix}")
        if route.to not in (TO_GROUND, *names):
            choices = ", ".join((TO_GROUND, *sorted(names)))
            raise ConfigError(f"route to {route.to!r}: choose one of {choices}")
        if route.to == route.source:
            raise ConfigError(f"route from {route.source} to itself: leave it out")
    before = dictionary.applications
    found = Dictionary(applications=tuple(_with_reports(one, routes, names) for one in before))
    own = (0.0 if one.name in names else housekeeping_bps(one) for one in before)
    rate_bps = sum(map(housekeeping_bps, found.applications)) - sum(own)
    if routes and rate_bps > MOST_HOUSEKEEPING_BPS:
        raise ConfigError(
            f"the reports of routes and components take {rate_bps:.0f} bit/s of "
            f"{MOST_HOUSEKEEPING_BPS}: give routes a longer period_s, or fewer data"
        )
    return found


def _with_reports(
    table: Application, routes: Sequence[TelemetryRoute], components: set[str]
) -> Application:
    own = [route for route in routes if route.source == table.name]
    # What an application in space sends to a component crosses the link.
    told = [route for route in own if route.to == TO_GROUND or table.end == "space"]
    kept = () if own and table.name in components else table.structures
    first = max((one.number for one in kept), default=0) + 1
    return replace(
        table,
        structures=(
            *kept,
            *(
                Structure(
                    name=f"route_{number}",
                    number=number,
                    parameters=route.data,
                    interval_s=route.period_s,
                    text=f"to {route.to}",
                )
                for number, route in enumerate(told, first)
            ),
        ),
    )
