"""The dictionary as XTCE 1.2 (OMG formal/18-02-04), for other ground systems.

The containers inherit from each other: a space packet, a PUS report or telecommand, then one for
each structure, event, function and kind of verification. Lists of numbers, several parameters in
one report (20,2) or telecommand (20,3), and K2ACI stay octets. Walls for model-mediated haptics
are space packets without PUS (`telepresence.haptics.mediated`).
"""

from xml.etree import ElementTree

from telepresence.haptics.mediated.wall import WALL_APID
from telepresence.tmtc.pus.dictionary import Application, Dictionary
from telepresence.tmtc.pus.xtce_commands import (
    FOREIGN_SOURCES,
    add,
    add_commands,
    add_integer_type,
    add_type,
)

NAMESPACE = "http://www.omg.org/spec/XTCE/20180204"
_SCHEMA = "https://www.omg.org/spec/XTCE/20180204/SpaceSystem.xsd"
_INSTANCE = "http://www.w3.org/2001/XMLSchema-instance"

#: Fields of the primary and of the secondary header, with their lengths in bits.
_PRIMARY = {
    "VERSION": 3,
    "TYPE": 1,
    "SEC_HDR_FLG": 1,
    "PKT_APID": 11,
    "SEQ_FLGS": 2,
    "SRC_SEQ_CTR": 14,
    "PKT_LEN": 16,
}
_SECONDARY = {
    "PUS_VERSION": 4,
    "TIME_STATUS": 4,
    "SERVICE": 8,
    "SUBTYPE": 8,
    "COUNTER": 16,
    "DESTINATION": 16,
}
#: The telecommand that a verification is about (clause 8.1.2.1).
_REQUEST = {"REQUEST_HEAD": 5, "REQUEST_APID": 11, "REQUEST_FLAGS": 2, "REQUEST_COUNT": 14}
#: Fields of a telecommand's secondary header, beside SERVICE and SUBTYPE.
_COMMAND = {"COMMAND_VERSION": 4, "ACKNOWLEDGE": 4, "SOURCE": 16}
#: Fields that are in no dictionary.
_OTHERS = {"STRUCTURE": 8, "EVENT": 8, "FUNCTION": 8, "FAILURE": 8, "CHECK": 16}
#: Of a report of parameters: how many there are, and the number of a single one.
_PARAMETERS = {"PARAMETERS": 8, "PARAMETER": 8}
#: Fields of a wall: the angle in 1/65536 turn, the distance signed, in 20 µm.
_WALL = {
    "WALL_VERSION": 8,
    "WALL_ANGLE": 16,
    "WALL_STAMP_MS": 24,
    "WALL_DISTANCE": 16,
    "WALL_STIFFNESS": 16,
}
_SIGNED = ("WALL_DISTANCE",)
#: Fields that fill the rest of the packet, with the octets around them after the primary header,
#: and whether they are text.
_RESTS = {
    "REASON": (20, True),
    "BODY": (15, False),
    "SETTINGS": (16, False),
    "NUMBERS": (7, False),
}
#: Telecommands that carry numbers of what they are about, or settings of parameters.
_WITH_NUMBERS = (
    *((3, 5), (3, 6), (3, 27), (5, 5), (5, 6), (12, 1), (12, 2), (19, 4), (19, 5)),
    *((20, 1), (20, 3)),
)

Criteria = tuple[tuple[str, int], ...]


def dictionary_xtce(dictionary: Dictionary, end: str = "ground") -> str:
    """Return the telemetry and the telecommands of `dictionary` as an XTCE document.

    end: where the other ground system is joined to a session, "ground" or "space".
    """
    root = ElementTree.Element(
        "SpaceSystem",
        {
            "xmlns": NAMESPACE,
            "xmlns:xsi": _INSTANCE,
            "xsi:schemaLocation": f"{NAMESPACE} {_SCHEMA}",
            "name": "kontur_av",
        },
    )
    telemetry = add(root, "TelemetryMetaData")
    types = add(telemetry, "ParameterTypeSet")
    parameters = add(telemetry, "ParameterSet")
    containers = add(telemetry, "ContainerSet")
    fields = {**_PRIMARY, **_SECONDARY, **_REQUEST, **_COMMAND, **_OTHERS, **_PARAMETERS, **_WALL}
    for name, bits in fields.items():
        _define(parameters, name)
        add_integer_type(types, "Parameter", f"{name}_TYPE", bits, signed=name in _SIGNED)
    for name, (octets, is_text) in _RESTS.items():
        _define(parameters, name)
        _rest(types, name, octets, text=is_text)
    _define(parameters, "TIME", "when it was reported")
    _time(types)
    for application in dictionary.applications:
        for parameter in application.parameters:
            name = f"{application.name}_{parameter.name}"
            _define(parameters, name, parameter.text)
            add_type(types, "Parameter", f"{name}_TYPE", parameter)
    _container(containers, "CCSDSPacket", _PRIMARY, abstract=True)
    secondary = (("TYPE", 0), ("SEC_HDR_FLG", 1))
    header = (*_SECONDARY, "TIME")
    _container(containers, "PusReport", header, "CCSDSPacket", secondary, abstract=True)
    _verification(containers)
    service = (("SERVICE", 3), ("SUBTYPE", 25))
    _container(containers, "Housekeeping", ("STRUCTURE",), "PusReport", service, abstract=True)
    events = (("SERVICE", 5),)
    _container(containers, "Event", ("EVENT",), "PusReport", events, abstract=True)
    _container(containers, "Alive", ("CHECK",), "PusReport", (("SERVICE", 17), ("SUBTYPE", 2)))
    k2aci = (("SERVICE", 129), ("SUBTYPE", 1))
    _container(containers, "K2aci", ("BODY", "CHECK"), "PusReport", k2aci)
    values = (("SERVICE", 20), ("SUBTYPE", 2))
    counted = ("PARAMETERS",)
    _container(containers, "ParameterReport", counted, "PusReport", values, abstract=True)
    several = ("SETTINGS", "CHECK")
    _container(
        containers, "Parameters", several, "ParameterReport", (("PARAMETERS", 1),), not_=True
    )
    single = (("PARAMETERS", 1),)
    _container(containers, "OneParameter", ("PARAMETER",), "ParameterReport", single, abstract=True)
    _telecommands(containers)
    wall = (("TYPE", 0), ("SEC_HDR_FLG", 0), ("PKT_APID", WALL_APID))
    _container(containers, "Wall", _WALL, "CCSDSPacket", wall)
    for application in dictionary.applications:
        _application(containers, application)
    add_commands(add(root, "CommandMetaData"), dictionary, FOREIGN_SOURCES[end])
    ElementTree.indent(root)
    text = ElementTree.tostring(root, encoding="unicode")
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{text}\n'


def _application(containers: ElementTree.Element, application: Application) -> None:
    def fields(*names: str) -> tuple[str, ...]:
        return (*(f"{application.name}_{name}" for name in names), "CHECK")

    apid = ("PKT_APID", application.apid)
    for structure in application.structures:
        criteria = (apid, ("STRUCTURE", structure.number))
        name = f"{application.name}_report_{structure.name}"
        _container(containers, name, fields(*structure.parameters), "Housekeeping", criteria)
    for event in application.events:
        criteria = (apid, ("EVENT", event.number))
        name = f"{application.name}_event_{event.name}"
        _container(containers, name, fields(*event.arguments), "Event", criteria)
    for parameter in application.parameters:
        criteria = (apid, ("PARAMETER", parameter.number))
        name = f"{application.name}_parameter_{parameter.name}"
        _container(containers, name, fields(parameter.name), "OneParameter", criteria)
    for function in application.functions:
        criteria = (apid, ("FUNCTION", function.number))
        name = f"{application.name}_function_{function.name}"
        _container(containers, name, fields(*function.arguments), "Function", criteria)


def _telecommands(containers: ElementTree.Element) -> None:
    header = ("COMMAND_VERSION", "ACKNOWLEDGE", "SERVICE", "SUBTYPE", "SOURCE")
    secondary = (("TYPE", 1), ("SEC_HDR_FLG", 1))
    _container(containers, "PusTelecommand", header, "CCSDSPacket", secondary, abstract=True)
    calls = (("SERVICE", 8), ("SUBTYPE", 1))
    _container(containers, "Function", ("FUNCTION",), "PusTelecommand", calls, abstract=True)
    alive = (("SERVICE", 17), ("SUBTYPE", 1))
    _container(containers, "AreYouAlive", ("CHECK",), "PusTelecommand", alive)
    for service, subtype in _WITH_NUMBERS:
        criteria = (("SERVICE", service), ("SUBTYPE", subtype))
        name = f"Request{service}_{subtype}"
        _container(containers, name, ("NUMBERS", "CHECK"), "PusTelecommand", criteria)


def _verification(containers: ElementTree.Element) -> None:
    for name, subtypes, entries in (
        ("Success", (1, 3, 7), (*_REQUEST, "CHECK")),
        ("Failure", (2, 4, 8, 10), (*_REQUEST, "FAILURE", "REASON", "CHECK")),
    ):
        for subtype in subtypes:
            criteria = (("SERVICE", 1), ("SUBTYPE", subtype))
            _container(containers, f"{name}{subtype}", entries, "PusReport", criteria)


def _define(parameters: ElementTree.Element, name: str, text: str = "") -> None:
    described = {"shortDescription": text} if text else {}
    add(parameters, "Parameter", name=name, parameterTypeRef=f"{name}_TYPE", **described)


def _time(types: ElementTree.Element) -> None:
    """CUC: 4 octets of seconds and 2 of their fraction, as one number of 2^-16 s."""
    kind = add(types, "AbsoluteTimeParameterType", name="TIME_TYPE")
    encoding = add(kind, "Encoding", units="seconds", scale=repr(2**-16), offset="0")
    add(encoding, "IntegerDataEncoding", sizeInBits="48", encoding="unsigned")
    add(add(kind, "ReferenceTime"), "Epoch", "UNIX")


def _rest(types: ElementTree.Element, name: str, octets: int, *, text: bool) -> None:
    """A field from here to the check. The length field counts the octets but one."""
    tag = "String" if text else "Binary"
    kind = add(types, f"{tag}ParameterType", name=f"{name}_TYPE")
    if text:
        encoding = add(kind, "StringDataEncoding", encoding="US-ASCII")
        size = add(encoding, "Variable", maxSizeInBits="1600")
    else:
        size = add(add(kind, "BinaryDataEncoding"), "SizeInBits")
    value = add(size, "DynamicValue")
    add(value, "ParameterInstanceRef", parameterRef="PKT_LEN")
    add(value, "LinearAdjustment", slope="8", intercept=str(8 * (1 - octets)))


def _container(
    containers: ElementTree.Element,
    name: str,
    entries: tuple[str, ...] | dict[str, int],
    base: str = "",
    criteria: Criteria = (),
    *,
    abstract: bool = False,
    not_: bool = False,
) -> None:
    """not_: the fields of `criteria` have other values than those."""
    container = add(
        containers, "SequenceContainer", name=name, abstract="true" if abstract else "false"
    )
    listed = add(container, "EntryList")
    for entry in entries:
        add(listed, "ParameterRefEntry", parameterRef=entry)
    if base:
        inherited = add(container, "BaseContainer", containerRef=base)
        comparisons = add(add(inherited, "RestrictionCriteria"), "ComparisonList")
        operator = {"comparisonOperator": "!="} if not_ else {}
        for field, value in criteria:
            add(comparisons, "Comparison", parameterRef=field, **operator, value=str(value))
