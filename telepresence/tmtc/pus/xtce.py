"""The dictionary as XTCE 1.2 (OMG formal/18-02-04), so that other ground systems read telemetry.

The containers inherit from each other: a space packet, a PUS report or telecommand, then one for
each structure, event, function and kind of verification. Lists of numbers, a list of parameters
(20,2 20,3) and K2ACI stay octets. A parameter in no structure, event or function is left out.
Walls for model-mediated haptics are space packets without PUS (`telepresence.haptics.mediated`).
"""

from xml.etree import ElementTree

from telepresence.haptics.mediated.wall import WALL_APID
from telepresence.tmtc.pus.dictionary import Application, Dictionary
from telepresence.tmtc.pus.values import INTEGERS, Parameter

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
    "TIME_S": 32,
    "TIME_FRACTION": 16,
}
#: Fields of a telecommand's secondary header, beside SERVICE and SUBTYPE.
_COMMAND = {"COMMAND_VERSION": 4, "ACKNOWLEDGE": 4, "SOURCE": 16}
#: Fields that are in no dictionary.
_OTHERS = {"STRUCTURE": 8, "EVENT": 8, "FUNCTION": 8, "REQUEST": 32, "FAILURE": 8, "CHECK": 16}
#: Fields of a wall. The surface is signed, in 20 µm.
_WALL = {
    "WALL_VERSION": 8,
    "WALL_DIRECTION": 8,
    "WALL_STAMP_MS": 32,
    "WALL_SURFACE": 16,
    "WALL_STIFFNESS": 16,
}
_SIGNED = ("WALL_SURFACE",)
#: Fields that fill the rest of the packet, with the octets around them after the primary header,
#: and whether they are text.
_RESTS = {"REASON": (20, True), "BODY": (15, False), "NUMBERS": (7, False)}
#: Telecommands that carry numbers of what they are about, or settings of parameters.
_WITH_NUMBERS = (
    *((3, 5), (3, 6), (3, 27), (5, 5), (5, 6), (12, 1), (12, 2), (19, 4), (19, 5)),
    *((20, 1), (20, 3)),
)

Criteria = tuple[tuple[str, int], ...]


def dictionary_xtce(dictionary: Dictionary) -> str:
    """Return the telemetry of `dictionary` as an XTCE document."""
    root = ElementTree.Element(
        "SpaceSystem",
        {
            "xmlns": NAMESPACE,
            "xmlns:xsi": _INSTANCE,
            "xsi:schemaLocation": f"{NAMESPACE} {_SCHEMA}",
            "name": "kontur-av",
        },
    )
    telemetry = ElementTree.SubElement(root, "TelemetryMetaData")
    types = ElementTree.SubElement(telemetry, "ParameterTypeSet")
    parameters = ElementTree.SubElement(telemetry, "ParameterSet")
    containers = ElementTree.SubElement(telemetry, "ContainerSet")
    for name, bits in {**_PRIMARY, **_SECONDARY, **_COMMAND, **_OTHERS, **_WALL}.items():
        _define(parameters, name)
        _integer(types, name, bits)
    for name, (octets, is_text) in _RESTS.items():
        _define(parameters, name)
        _rest(types, name, octets, text=is_text)
    for application in dictionary.applications:
        reported = {name for structure in application.structures for name in structure.parameters}
        reported.update(name for event in application.events for name in event.arguments)
        reported.update(name for function in application.functions for name in function.arguments)
        for parameter in application.parameters:
            if parameter.name not in reported:
                continue
            name = f"{application.name}_{parameter.name}"
            _define(parameters, name, parameter.text)
            _parameter_type(types, name, parameter)
    _container(containers, "CCSDSPacket", _PRIMARY, abstract=True)
    secondary = (("TYPE", 0), ("SEC_HDR_FLG", 1))
    _container(containers, "PusReport", _SECONDARY, "CCSDSPacket", secondary, abstract=True)
    _verification(containers)
    service = (("SERVICE", 3), ("SUBTYPE", 25))
    _container(containers, "Housekeeping", ("STRUCTURE",), "PusReport", service, abstract=True)
    events = (("SERVICE", 5),)
    _container(containers, "Event", ("EVENT",), "PusReport", events, abstract=True)
    _container(containers, "Alive", ("CHECK",), "PusReport", (("SERVICE", 17), ("SUBTYPE", 2)))
    for name, criteria in (
        ("Parameters", (("SERVICE", 20), ("SUBTYPE", 2))),
        ("K2aci", (("SERVICE", 129), ("SUBTYPE", 1))),
    ):
        _container(containers, name, ("BODY", "CHECK"), "PusReport", criteria)
    _telecommands(containers)
    wall = (("TYPE", 0), ("SEC_HDR_FLG", 0), ("PKT_APID", WALL_APID))
    _container(containers, "Wall", _WALL, "CCSDSPacket", wall)
    for application in dictionary.applications:
        _application(containers, application)
    ElementTree.indent(root)
    text = ElementTree.tostring(root, encoding="unicode")
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{text}\n'


def _application(containers: ElementTree.Element, application: Application) -> None:
    def fields(names: tuple[str, ...]) -> tuple[str, ...]:
        return (*(f"{application.name}_{name}" for name in names), "CHECK")

    apid = ("PKT_APID", application.apid)
    for structure in application.structures:
        criteria = (apid, ("STRUCTURE", structure.number))
        name = f"{application.name}_report_{structure.name}"
        _container(containers, name, fields(structure.parameters), "Housekeeping", criteria)
    for event in application.events:
        criteria = (apid, ("EVENT", event.number))
        name = f"{application.name}_event_{event.name}"
        _container(containers, name, fields(event.arguments), "Event", criteria)
    for function in application.functions:
        criteria = (apid, ("FUNCTION", function.number))
        name = f"{application.name}_function_{function.name}"
        _container(containers, name, fields(function.arguments), "Function", criteria)


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
        ("Success", (1, 3, 7), ("REQUEST", "CHECK")),
        ("Failure", (2, 4, 8, 10), ("REQUEST", "FAILURE", "REASON", "CHECK")),
    ):
        for subtype in subtypes:
            criteria = (("SERVICE", 1), ("SUBTYPE", subtype))
            _container(containers, f"{name}{subtype}", entries, "PusReport", criteria)


def _define(parameters: ElementTree.Element, name: str, text: str = "") -> None:
    attributes = {"name": name, "parameterTypeRef": f"{name}_TYPE"}
    if text:
        attributes["shortDescription"] = text
    ElementTree.SubElement(parameters, "Parameter", attributes)


def _integer(types: ElementTree.Element, name: str, bits: int) -> None:
    signed = name in _SIGNED
    kind = ElementTree.SubElement(
        types,
        "IntegerParameterType",
        {"name": f"{name}_TYPE", "signed": "true" if signed else "false"},
    )
    coding = "twosComplement" if signed else "unsigned"
    encoding = {"sizeInBits": str(bits), "encoding": coding}
    ElementTree.SubElement(kind, "IntegerDataEncoding", encoding)


def _rest(types: ElementTree.Element, name: str, octets: int, *, text: bool) -> None:
    """A field from here to the check. The length field counts the octets but one."""
    tag = "String" if text else "Binary"
    kind = ElementTree.SubElement(types, f"{tag}ParameterType", {"name": f"{name}_TYPE"})
    if text:
        encoding = ElementTree.SubElement(kind, "StringDataEncoding", {"encoding": "US-ASCII"})
        size = ElementTree.SubElement(encoding, "Variable", {"maxSizeInBits": "1600"})
    else:
        encoding = ElementTree.SubElement(kind, "BinaryDataEncoding")
        size = ElementTree.SubElement(encoding, "SizeInBits")
    value = ElementTree.SubElement(size, "DynamicValue")
    ElementTree.SubElement(value, "ParameterInstanceRef", {"parameterRef": "PKT_LEN"})
    line = {"slope": "8", "intercept": str(8 * (1 - octets))}
    ElementTree.SubElement(value, "LinearAdjustment", line)


def _parameter_type(types: ElementTree.Element, name: str, parameter: Parameter) -> None:
    names = {"name": f"{name}_TYPE"}
    bits = str(8 * parameter.octets)
    if parameter.type == "choice":
        kind = ElementTree.SubElement(types, "EnumeratedParameterType", names)
        _units(kind, parameter)
        encoding = {"sizeInBits": bits, "encoding": "unsigned"}
        ElementTree.SubElement(kind, "IntegerDataEncoding", encoding)
        labels = ElementTree.SubElement(kind, "EnumerationList")
        for number, label in enumerate(parameter.choices):
            attributes = {"value": str(number), "label": label}
            ElementTree.SubElement(labels, "Enumeration", attributes)
        return
    if parameter.type == "text":
        kind = ElementTree.SubElement(types, "StringParameterType", names)
        encoded = ElementTree.SubElement(kind, "StringDataEncoding", {"encoding": "US-ASCII"})
        size = ElementTree.SubElement(encoded, "SizeInBits")
        ElementTree.SubElement(ElementTree.SubElement(size, "Fixed"), "FixedValue").text = bits
        ElementTree.SubElement(size, "TerminationChar").text = "00"
        return
    if parameter.type == "bool":
        names |= {"zeroStringValue": "false", "oneStringValue": "true"}
        kind = ElementTree.SubElement(types, "BooleanParameterType", names)
        _units(kind, parameter)
        encoding = {"sizeInBits": bits, "encoding": "unsigned"}
        ElementTree.SubElement(kind, "IntegerDataEncoding", encoding)
        return
    if parameter.type == "f32":
        kind = ElementTree.SubElement(types, "FloatParameterType", names)
        _units(kind, parameter)
        ElementTree.SubElement(
            kind, "FloatDataEncoding", {"sizeInBits": bits, "encoding": "IEEE754_1985"}
        )
    else:
        signed = INTEGERS[parameter.type][1] < 0
        scaled = parameter.scale != 1
        if not scaled:
            names["signed"] = "true" if signed else "false"
        tag = "FloatParameterType" if scaled else "IntegerParameterType"
        kind = ElementTree.SubElement(types, tag, names)
        _units(kind, parameter)
        coding = {"sizeInBits": bits, "encoding": "twosComplement" if signed else "unsigned"}
        encoded = ElementTree.SubElement(kind, "IntegerDataEncoding", coding)
        if scaled:
            calibrator = ElementTree.SubElement(encoded, "DefaultCalibrator")
            line = ElementTree.SubElement(calibrator, "PolynomialCalibrator")
            for exponent, value in enumerate(("0", repr(parameter.scale))):
                term = {"coefficient": value, "exponent": str(exponent)}
                ElementTree.SubElement(line, "Term", term)
    _limits(kind, parameter)


def _units(kind: ElementTree.Element, parameter: Parameter) -> None:
    if parameter.unit:
        units = ElementTree.SubElement(kind, "UnitSet")
        ElementTree.SubElement(units, "Unit").text = parameter.unit


def _limits(kind: ElementTree.Element, parameter: Parameter) -> None:
    if parameter.low is None and parameter.high is None:
        return
    alarm = ElementTree.SubElement(kind, "DefaultAlarm")
    ranges = ElementTree.SubElement(alarm, "StaticAlarmRanges")
    attributes = {}
    if parameter.low is not None:
        attributes["minInclusive"] = repr(parameter.low)
    if parameter.high is not None:
        attributes["maxInclusive"] = repr(parameter.high)
    ElementTree.SubElement(ranges, "WarningRange", attributes)


def _container(
    containers: ElementTree.Element,
    name: str,
    entries: tuple[str, ...] | dict[str, int],
    base: str = "",
    criteria: Criteria = (),
    *,
    abstract: bool = False,
) -> None:
    attributes = {"name": name, "abstract": "true" if abstract else "false"}
    container = ElementTree.SubElement(containers, "SequenceContainer", attributes)
    listed = ElementTree.SubElement(container, "EntryList")
    for entry in entries:
        ElementTree.SubElement(listed, "ParameterRefEntry", {"parameterRef": entry})
    if base:
        inherited = ElementTree.SubElement(container, "BaseContainer", {"containerRef": base})
        restricted = ElementTree.SubElement(inherited, "RestrictionCriteria")
        comparisons = ElementTree.SubElement(restricted, "ComparisonList")
        for field, value in criteria:
            comparison = {"parameterRef": field, "value": str(value)}
            ElementTree.SubElement(comparisons, "Comparison", comparison)
