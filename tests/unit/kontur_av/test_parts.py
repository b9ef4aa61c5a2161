"""The doors of parts: built-in ones and a user's are made by the same rules."""

from types import SimpleNamespace

import pytest

from kontur_av import parts
from kontur_av.errors import ConfigError
from kontur_av.parts import PluginRegistry, find_part, make_part
from kontur_av.sources import spec as sources
from telepresence.haptics.specs import JOYSTICK_PLUGINS, ROBOT_PLUGINS

DOORS = (ROBOT_PLUGINS, JOYSTICK_PLUGINS, sources._VIDEO, sources._AUDIO)
BUILT_IN = [(admission, name) for admission in DOORS for name in admission.built_in]


def plain(text=""):
    return ("plain", text)


def asking(text="", *, axes=()):
    return (axes, text)


def faulty():
    return 1 // 0


HERE = {name: f"{__name__}:{name}" for name in ("plain", "asking", "faulty")}
PLUGINS = PluginRegistry("thing", "plain or module:Class", "kontur_av.things", HERE)


@pytest.fixture(autouse=True)
def here(monkeypatch):
    monkeypatch.setattr(parts.importlib, "import_module", lambda _: SimpleNamespace(**globals()))


@pytest.mark.parametrize(("admission", "name"), BUILT_IN)
def test_each_built_in_part_is_found_without_reading_metadata(admission, name, monkeypatch):
    monkeypatch.undo()
    monkeypatch.setattr(parts, "entry_points", None)
    made, text = find_part(f"{name}:a:b", admission)
    assert callable(made) and text == ("a:b",)


@pytest.mark.parametrize("form", ["{}", "things:{}"])
def test_a_part_gets_what_it_asks_for(form):
    assert make_part(form.format("plain"), PLUGINS, axes=("z",)) == ("plain", "")
    assert make_part(form.format("asking") + ":x:1", PLUGINS, axes=("z",)) == (("z",), "x:1")
    with pytest.raises(ConfigError, match="too many positional arguments"):
        make_part("faulty:x", PLUGINS)


def test_a_users_fault_is_theirs_and_ours_is_a_bug():
    with pytest.raises(ConfigError, match="cannot be made: ZeroDivisionError"):
        make_part("things:faulty", PLUGINS)
    with pytest.raises(ZeroDivisionError):
        make_part("faulty", PLUGINS)


def test_what_is_unknown_is_told_what_may_stand_there():
    with pytest.raises(ConfigError, match=r"^thing 'plane': write plain or module:Class$"):
        make_part("plane", PLUGINS)
