"""Values on the wire: their octets, what is cut or refused, and limits of telecommands."""

from math import inf, nan

import pytest

from kontur_av.errors import ConfigError, ProtocolError
from telepresence.tmtc.pus.values import Parameter, pack_values, unpack_values

CELLS = ("a", "b")


def one(kind, **fields):
    return Parameter(name="x", number=1, type=kind, **fields)


WORD, LISTED = one("text", size=3), one("text", size=3, choices=("ab", "abc"))


@pytest.mark.parametrize(
    ("parameter", "value", "octets"),
    [
        (one("u8"), 200, "c8"),
        (one("u16"), 0x1234, "1234"),
        (one("u32"), 0x12345678, "12345678"),
        (one("i8"), -2, "fe"),
        (one("i16"), -2, "fffe"),
        (one("i32"), -2, "fffffffe"),
        (one("u16", scale=0.5), 40.5, "0051"),
        (one("i32", scale=0.00001), 0.06294, "00001896"),
        (one("f32"), 1.5, "3fc00000"),
        (one("f32"), inf, "7f800000"),
        (one("bool"), True, "01"),
        (one("bool"), False, "00"),
        (one("choice", choices=CELLS), "b", "01"),
        # A zero ends a text, and zeros fill it up.
        (WORD, "abc", "61626300"),
        (LISTED, "ab", "61620000"),
    ],
)
def test_a_value_has_these_octets(parameter, value, octets):
    assert parameter.pack(value) == bytes.fromhex(octets)
    assert parameter.octets == len(octets) // 2
    found = parameter.unpack(bytes.fromhex(octets))
    assert (found, type(found)) == (value, type(value))


@pytest.mark.parametrize("bits", [8, 16, 32])
@pytest.mark.parametrize("scale", [1, 0.25])
def test_a_number_out_of_range_is_cut_to_it(bits, scale):
    for kind, least in ((f"u{bits}", 0), (f"i{bits}", -(1 << bits - 1))):
        number, most = one(kind, scale=scale), least + (1 << bits) - 1
        for beyond, limit in ((least - 1, least), (most + 1, most)):
            assert number.unpack(number.pack(beyond * scale)) == limit * scale
            assert number.unpack(number.pack(limit * scale)) == limit * scale
    assert one("f32").pack(1e39) == bytes.fromhex("7f800000")
    assert one("f32").pack(-1e39) == bytes.fromhex("ff800000")


@pytest.mark.parametrize(
    ("parameter", "values", "fix"),
    [
        (one("choice", choices=CELLS), ["c"], "choose one of a, b"),
        (one("bool"), [1], "give true or false"),
        (one("u8"), ["1", True], "give a number"),
        (one("f32"), ["1"], "give a number"),
        (one("u8"), [nan], "give a finite number"),
        (WORD, ["", "abcd", "ä", "a\n", 5], "give 1 to 3 printable"),
        (LISTED, ["b"], "choose one of ab, abc"),
    ],
)
def test_an_unfit_value_is_refused_with_what_fits(parameter, values, fix):
    for value in values:
        with pytest.raises(ConfigError, match=fix):
            parameter.pack(value)


def test_octets_of_no_value_are_garbage():
    texts = ((WORD, "00000000 61626364 61006200 e4000000"), (LISTED, "62000000"))
    for parameter, octets in ((one("choice", choices=CELLS), "02"), (one("bool"), "02"), *texts):
        for wrong in octets.split():
            with pytest.raises(ProtocolError, match="x"):
                parameter.unpack(bytes.fromhex(wrong))


def test_a_telecommand_keeps_limits_and_one_on_them_does():
    within = one("i16", low=-1, high=2)
    for value in (-1, 0, 2, "text"):
        within.check(value)
    for value in (-1.5, 2.5, nan, inf):
        with pytest.raises(ProtocolError, match=r"give at least -1 and at most 2$"):
            within.check(value)
    with pytest.raises(ProtocolError, match="x is inf: give a finite number"):
        one("f32").check(inf)
    one("f32").check(-1e30)
    # 0.7 and 0.1 have no exact number of 32 bits: one is below, one above.
    for limits in ({"low": 0.7}, {"high": 0.1}):
        (limit,) = limits.values()
        rough = one("f32", **limits)
        rough.check(rough.unpack(rough.pack(limit)))


def test_values_follow_each_other_and_fill_their_octets():
    several = (one("u8"), one("u16"), one("bool"))
    octets = pack_values(several, [1, 2, True])
    assert octets == bytes.fromhex("01000201")
    assert unpack_values(several, octets) == (1, 2, True)
    for wrong in (octets[:-1], octets + b"\0"):
        with pytest.raises(ProtocolError, match="for 3 parameters"):
            unpack_values(several, wrong)
    with pytest.raises(ConfigError, match="1 values: give nothing"):
        pack_values((), [1])
