"""Types of parameters and of arguments in XTCE: encoding, unit, limits, enumeration."""

from collections.abc import Iterable
from xml.etree import ElementTree

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
