"""TOML files of a user: each mistake is one line that names field, value and what would fit."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from kontur_av.errors import ConfigError
from telepresence.toml_file import check_known, read_toml, typed


@dataclass(frozen=True, kw_only=True)
class Wheel:
    radius_m: float
    spokes: int = 30

    def __post_init__(self):
        if self.radius_m <= 0:
            raise ConfigError(f"radius_m is {self.radius_m:g}: take more than 0")


@dataclass(frozen=True, kw_only=True)
class Cart:
    name: str
    front: Wheel
    rear: Wheel | None = None
    spares: tuple[Wheel, ...] = ()
    loaded: bool = False
    names: tuple[str, ...] = field(default=(), metadata={"like": 'a list, like ["a"]'})
    notes: Mapping[str, str] = field(default_factory=dict)


WHOLE = {"name": "x", "front": {"radius_m": 1}}


def test_valid_values_have_their_types():
    more = {"names": ["a"], "notes": {"b": "c"}}
    cart = typed({**WHOLE, "spares": [{"radius_m": 0.5, "spokes": 3}], **more}, Cart, "a cart")
    front, spare = Wheel(radius_m=1.0), Wheel(radius_m=0.5, spokes=3)
    assert cart == Cart(name="x", front=front, spares=(spare,), names=("a",), notes={"b": "c"})
    assert isinstance(cart.front.radius_m, float)


FRONT = "front.radius_m"


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"nam": "y"}, "unknown field nam: the nearest one is name"),
        ({"front": {"radius": 1}}, f"unknown field front.radius: the nearest one is {FRONT}"),
        ({"spares": [{"spoke": 1}]}, "spares.spoke: the nearest one is spares.spokes"),
        ({"name": 3}, "name must be a text in quotes, not 3"),
        ({"loaded": 1}, "loaded must be true or false, not 1"),
        ({FRONT: "1"}, "front.radius_m must be a number, not '1'"),
        ({FRONT: True}, "front.radius_m must be a number, not true"),
        ({FRONT: float("inf")}, "front.radius_m is inf: it must be a finite number"),
        ({FRONT: 1e300}, "front.radius_m is too large"),
        ({FRONT: -1}, "radius_m is -1: take more than 0"),
        ({"front": {"radius_m": 1, "spokes": 16**5000}}, "front.spokes is too large"),
        ({"front": {"radius_m": 1, "spokes": 2.5}}, "front.spokes must be a whole number, not 2.5"),
        ({"front": {}}, "front needs radius_m"),
        ({"front": 1}, "front must be a table with radius_m, spokes: a table [front], not 1"),
        ({"rear": 1}, "rear must be a table with radius_m, spokes: a table [rear], not 1"),
        ({"spares": 1}, "spares must be tables [[spares]], not 1"),
        ({"spares": [{"radius_m": "a"}]}, "spares.radius_m must be a number, not 'a'"),
        ({"names": "a"}, "names must be a list, like [\"a\"], not 'a'"),
        ({"notes": {"a": 1}}, "notes must be a text in quotes throughout"),
    ],
)
def test_each_mistake_is_named(changes, message):
    if FRONT in changes:
        changes = {"front": {"radius_m": changes[FRONT]}}
    with pytest.raises(ConfigError, match=re.escape(message)) as caught:
        typed({**WHOLE, **changes}, Cart, "a cart")
    assert "\n" not in str(caught.value)
    assert "msgspec" not in str(caught.value)


def test_missing_fields_are_named_at_once_and_those_that_the_caller_removes_are_known():
    with pytest.raises(ConfigError, match=r"^a cart needs name and front$"):
        typed({}, Cart, "a cart")

    check_known({"base": 1, **WHOLE}, Cart, also=("base",))
    with pytest.raises(ConfigError, match="nearest one is base"):
        check_known({"bases": 1}, Cart, also=("base",))


def test_files_that_cannot_be_read(tmp_path):
    path = tmp_path / "odd.toml"
    with pytest.raises(ConfigError, match=r"cannot read cart .*odd\.toml: No such file"):
        read_toml(path, "cart")
    with pytest.raises(ConfigError, match="is not TOML"):
        read_toml(Path("\0.toml"), "cart")
    for octets, says in (
        (b"name = ", r"cart .*odd\.toml is not TOML: "),
        ('a = "é"'.encode("utf-16"), "is not TOML: octet 0 is no UTF-8: save it as UTF-8$"),
        (b"name = " + b"9" * 5000, "is not TOML"),
        (b"name = " + b"[" * 5000, "is not TOML"),
    ):
        path.write_bytes(octets)
        with pytest.raises(ConfigError, match=says):
            read_toml(path, "cart")


def test_editors_of_other_systems_may_have_written_a_file(tmp_path):
    path = tmp_path / "cart.toml"
    for end in ("\n", "\r\n"):
        path.write_bytes(b"\xef\xbb\xbf" + f'name = "x"{end}[front]{end}'.encode())
        assert read_toml(path, "cart") == {"name": "x", "front": {}}
