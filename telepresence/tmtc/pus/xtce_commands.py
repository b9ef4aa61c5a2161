"""The telecommands of a dictionary as XTCE: arguments, ranges, enumerations, verifiers.

A ground system fills in the sequence count, the length and the check. SOURCE is its number,
`FOREIGN_SOURCES`: the reports about its telecommands carry it as their destination, so that those
of other users are not mistaken for them. The verifiers are in the dialect of YAMCS, which has the
names of what was sent; XTCE itself has none.
"""

from collections.abc import Iterable
from typing import NamedTuple
from xml.etree import ElementTree

from telepresence.tmtc.pus.dictionary import Application, Dictionary
from telepresence.tmtc.pus.values import INTEGERS, Parameter


def add(parent: ElementTree.Element, tag: str, text: str = "", **named: str) -> ElementTree.Element:
    """Return a new last child of `parent`, with the attributes `named`."""
    child = ElementTree.SubElement(parent, tag, named)
    if text:
        child.text = text
    return child


def add_integer_type(
    types: ElementTree.Element, kind: str, name: str, bits: int, *, signed: bool = False
) -> None:
    """Add the type of a whole number. kind: "Parameter" or "Argument"."""
    element = add(types, f"Integer{kind}Type", name=name, signed="true" if signed else "false")
    _integer(element, bits, signed=signed)


def add_choice_type(
    types: ElementTree.Element,
    kind: str,
    name: str,
    labels: Iterable[tuple[int, str]],
    bits: int = 8,
    unit: str = "",
) -> None:
    """Add the type of a choice. labels: of its numbers."""
    element = add(types, f"Enumerated{kind}Type", name=name)
    _units(element, unit)
    _integer(element, bits, signed=False)
    listed = add(element, "EnumerationList")
    for number, label in labels:
        add(listed, "Enumeration", value=str(number), label=label)


def add_type(types: ElementTree.Element, kind: str, name: str, parameter: Parameter) -> None:
    """Add the type of a parameter, or of an argument that has its type.

    A parameter beyond its limits is a warning; an argument beyond them is refused.
    """
    bits = 8 * parameter.octets
    if parameter.type == "choice":
        labels = enumerate(parameter.choices)
        add_choice_type(types, kind, name, labels, bits, parameter.unit)
        return
    if parameter.type == "text":
        element = add(types, f"String{kind}Type", name=name)
        encoded = add(element, "StringDataEncoding", encoding="US-ASCII")
        size = add(encoded, "SizeInBits")
        add(add(size, "Fixed"), "FixedValue", str(bits))
        add(size, "TerminationChar", "00")
        return
    if parameter.type == "bool":
        values = {"zeroStringValue": "false", "oneStringValue": "true"}
        element = add(types, f"Boolean{kind}Type", name=name, **values)
        _units(element, parameter.unit)
        _integer(element, bits, signed=False)
        return
    scaled = parameter.scale != 1
    if parameter.type == "f32":
        element = add(types, f"Float{kind}Type", name=name, sizeInBits="32")
        _units(element, parameter.unit)
        add(element, "FloatDataEncoding", sizeInBits=str(bits), encoding="IEEE754_1985")
    else:
        signed = INTEGERS[parameter.type][1] < 0
        told = {} if scaled else {"signed": "true" if signed else "false"}
        tag = "Float" if scaled else "Integer"
        element = add(types, f"{tag}{kind}Type", name=name, **told)
        _units(element, parameter.unit)
        encoding = _integer(element, bits, signed=signed)
        if scaled:
            line = add(add(encoding, "DefaultCalibrator"), "PolynomialCalibrator")
            # That of an argument leads from the value to the integer on the wire.
            slope = parameter.scale if kind == "Parameter" else 1 / parameter.scale
            for exponent, value in enumerate(("0", repr(slope))):
                add(line, "Term", coefficient=value, exponent=str(exponent))
    _limits(element, kind, parameter)


def _integer(element: ElementTree.Element, bits: int, *, signed: bool) -> ElementTree.Element:
    coding = "twosComplement" if signed else "unsigned"
    return add(element, "IntegerDataEncoding", sizeInBits=str(bits), encoding=coding)


def _units(element: ElementTree.Element, unit: str) -> None:
    if unit:
        add(add(element, "UnitSet"), "Unit", unit)


def _limits(element: ElementTree.Element, kind: str, parameter: Parameter) -> None:
    sides = {"minInclusive": parameter.low, "maxInclusive": parameter.high}
    whole = parameter.type in INTEGERS and parameter.scale == 1 and kind == "Argument"
    told = {
        side: repr(round(limit) if whole else limit)
        for side, limit in sides.items()
        if limit is not None
    }
    if not told:
        return
    if kind == "Parameter":
        add(add(add(element, "DefaultAlarm"), "StaticAlarmRanges"), "WarningRange", **told)
    else:
        ranges = add(element, "ValidRangeSet", validRangeAppliesToCalibrated="true")
        add(ranges, "ValidRange", **told)


#: By end: the number of users of other ground systems there, in telecommands and reports.
FOREIGN_SOURCES = {"ground": 3, "space": 4}

#: What all telecommands begin with, also in telemetry's containers.
_BASE = "PusTelecommand"
#: Argument of every telecommand -> its bits.
_HEADER = {"APID": 11, "ACKNOWLEDGE": 4, "SERVICE": 8, "SUBTYPE": 8, "SOURCE": 16}
#: In the order of the headers: an argument, or bits with their value.
_LAYOUT = (
    *((3, "00"), (1, "01"), (1, "01"), "APID", (2, "03"), (14, "0000"), (16, "0000")),
    *((4, "02"), "ACKNOWLEDGE", "SERVICE", "SUBTYPE", "SOURCE"),
)
#: Verifier -> its name, the subtypes that mean success and failure (clause 8.1.2), and how long
#: after the telecommand is released they may come: it is repeated for 30 s.
_STAGES = {
    "AcceptedVerifier": ("Accepted", (1,), (2, 10), "PT35S"),
    "ExecutionVerifier": ("Started", (3,), (4,), "PT35S"),
    "CompleteVerifier": ("Completed", (7,), (2, 4, 8, 10), "PT45S"),
}
#: Input of a verifier -> where it comes from.
_SENT = {
    "sentApid": "/yamcs/cmd/arg/APID",
    "sentCount": "/yamcs/cmdHist/ccsds-seqcount",
    "sentSource": "/yamcs/cmd/arg/SOURCE",
    "apid": "REQUEST_APID",
    "count": "REQUEST_COUNT",
    "destination": "DESTINATION",
    "subtype": "SUBTYPE",
}


def add_commands(commands: ElementTree.Element, dictionary: Dictionary, source: int) -> None:
    """Add the telecommands of all applications: those of `kontur-av tc`, under the same names.

    source: one of `FOREIGN_SOURCES`.
    """
    types = add(commands, "ArgumentTypeSet")
    metas = add(commands, "MetaCommandSet")
    for name, bits in _HEADER.items():
        add_integer_type(types, "Argument", f"{name}_TYPE", bits)
    _base(metas, source)
    for application in dictionary.applications:
        _Commands(types, metas, application).add_all()


def _base(metas: ElementTree.Element, source: int) -> None:
    meta = add(metas, "MetaCommand", name=_BASE, abstract="true")
    arguments = add(meta, "ArgumentList")
    initial = {"ACKNOWLEDGE": "15", "SOURCE": str(source)}
    for name in _HEADER:
        known = {"initialValue": initial[name]} if name in initial else {}
        add(arguments, "Argument", name=name, argumentTypeRef=f"{name}_TYPE", **known)
    entries = add(add(meta, "CommandContainer", name=_BASE), "EntryList")
    for field in _LAYOUT:
        if isinstance(field, str):
            add(entries, "ArgumentRefEntry", argumentRef=field)
        else:
            add(entries, "FixedValueEntry", sizeInBits=str(field[0]), binaryValue=field[1])
    verifiers = add(meta, "VerifierSet")
    for tag, (name, good, bad, window) in _STAGES.items():
        verifier = add(verifiers, tag, name=name)
        algorithm = add(verifier, "CustomAlgorithm", name=f"verify_{name.lower()}")
        needed = add(algorithm, "AncillaryDataSet")
        for one in _SENT:
            add(needed, "AncillaryData", one, name="Yamcs:AlgorithmMandatoryInput")
        add(algorithm, "AlgorithmText", _script(good, bad), language="JavaScript")
        inputs = add(algorithm, "InputSet")
        for one, reference in {**_SENT, "reason": "REASON"}.items():
            add(inputs, "InputParameterInstanceRef", parameterRef=reference, inputName=one)
        add(
            verifier,
            "CheckWindow",
            timeToStopChecking=window,
            timeWindowIsRelativeTo="commandRelease",
        )


def _script(good: Iterable[int], bad: Iterable[int]) -> str:
    def among(subtypes: Iterable[int]) -> str:
        return " || ".join(f"+subtype.value == {subtype}" for subtype in subtypes)

    # Two boxed integers of Java are equal by identity only; a sign makes them numbers.
    return (
        "if (+apid.value == +sentApid.value && +count.value == +sentCount.value"
        # The high octet of a source tells equal telecommands of two starts apart.
        " && (+destination.value & 255) == +sentSource.value) {"
        f" if ({among(good)}) return true;"
        f" if ({among(bad)}) return reason.value;"
        " }"
    )


class _Argument(NamedTuple):
    name: str
    kind: str
    text: str = ""


class _Commands:
    """The telecommands of one application."""

    def __init__(
        self, types: ElementTree.Element, metas: ElementTree.Element, application: Application
    ) -> None:
        self._types, self._metas, self._table = types, metas, application
        #: A function that is called like another telecommand goes before it.
        self._taken = {function.name for function in application.functions}

    def add_all(self) -> None:
        table = self._table
        for function in table.functions:
            arguments = self._arguments(function.name, table.named(function.arguments))
            self._add(function.name, (8, 1), function.text, (function.number,), arguments)
        events = [(event.number, event.name) for event in table.events]
        acting = {action.event for action in table.actions}
        structures = [(structure.number, structure.name) for structure in table.structures]
        monitors = [(monitor.number, monitor.name) for monitor in table.monitors]
        for name, message, of in (
            ("report", (3, 27), structures),
            ("on", (3, 5), structures),
            ("off", (3, 6), structures),
            ("events_on", (5, 5), events),
            ("events_off", (5, 6), events),
            ("limits_on", (12, 1), monitors),
            ("limits_off", (12, 2), monitors),
            ("actions_on", (19, 4), [event for event in events if event[1] in acting]),
            ("actions_off", (19, 5), [event for event in events if event[1] in acting]),
            ("get", (20, 1), [(one.number, one.name) for one in table.parameters]),
        ):
            if of and name not in self._taken:
                which = _Argument("which", f"{table.name}_{name}_which_TYPE")
                add_choice_type(self._types, "Argument", which.kind, of)
                self._add(name, message, "", (1,), (which,))
        if "ping" not in self._taken:
            self._add("ping", (17, 1))
        for parameter in table.parameters:
            name = f"set_{parameter.name}"
            if parameter.writable and name not in self._taken:
                arguments = self._arguments(name, (parameter,))
                self._add(name, (20, 3), parameter.text, (1, parameter.number), arguments)

    def _arguments(self, name: str, parameters: Iterable[Parameter]) -> tuple[_Argument, ...]:
        found = []
        for parameter in parameters:
            kind = f"{self._table.name}_{name}_{parameter.name}_TYPE"
            add_type(self._types, "Argument", kind, parameter)
            found.append(_Argument(parameter.name, kind, parameter.text))
        return tuple(found)

    def _add(
        self,
        name: str,
        message: tuple[int, int],
        text: str = "",
        fixed: Iterable[int] = (),
        arguments: Iterable[_Argument] = (),
    ) -> None:
        """Add one. message: service and subtype. fixed: the octets before its arguments."""
        full = f"{self._table.name}_{name}"
        described = {"shortDescription": text} if text else {}
        meta = add(self._metas, "MetaCommand", name=full, **described)
        base = add(meta, "BaseMetaCommand", metaCommandRef=_BASE)
        assigned = add(base, "ArgumentAssignmentList")
        told = (self._table.apid, *message)
        for argument, value in zip(("APID", "SERVICE", "SUBTYPE"), told, strict=True):
            add(assigned, "ArgumentAssignment", argumentName=argument, argumentValue=str(value))
        container = ElementTree.Element("CommandContainer", {"name": full})
        entries = add(container, "EntryList")
        for octet in fixed:
            add(entries, "FixedValueEntry", sizeInBits="8", binaryValue=f"{octet:02X}")
        listed = None
        for one in arguments:
            if listed is None:
                listed = add(meta, "ArgumentList")
            described = {"shortDescription": one.text} if one.text else {}
            add(listed, "Argument", name=one.name, argumentTypeRef=one.kind, **described)
            add(entries, "ArgumentRefEntry", argumentRef=one.name)
        add(container, "BaseContainer", containerRef=_BASE)
        meta.append(container)
