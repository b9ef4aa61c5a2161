"""Radio profiles by name and from TOML: what is inherited, and what is refused in one line."""

import re
import tomllib
from dataclasses import fields

import pytest
from positions import ROOT

from kontur_av.errors import ConfigError
from telepresence.link.radio import RadioProfile, load_radio
from telepresence.link.radio.channel import Bursts, RandomBlackouts
from telepresence.link.radio.contact import STORED_ELEMENTS, Contact
from telepresence.link.radio.network import Network
from telepresence.link.radio.profile import BUILT_IN, Blackout
from telepresence.link.radio.profile_file import radio_from_table

DOCUMENT = ROOT / "docs" / "simulation.md"


@pytest.fixture
def load(tmp_path):
    def load(text):
        path = tmp_path / "mine.toml"
        path.write_text(text, encoding="utf-8")
        return load_radio(str(path))

    return load


def test_a_file_without_a_base_begins_with_a_cable(load):
    profile = load("delay_ms = 5")
    assert profile == RadioProfile(name="mine", delay_ms=5.0)


def test_a_file_overrides_its_fields_and_inherits_the_rest(load):
    profile = load(
        'base = "iss-pass"\nname = "bad day"\n'
        "[contact]\nmargin_db = 4\n[bursts]\nmean_ms = 40\n"
        "[[blackouts]]\nstart_s = 60\nseconds = 2.5\n[[blackouts]]\nstart_s = 90\nseconds = 1\n"
        'direction = "uplink"\n[random_blackouts]\ngap_s = 30\nshortest_s = 0.1\nlongest_s = 1\n'
    )
    base = BUILT_IN["iss-pass"]
    assert profile.name == "bad day"
    assert profile.description == base.description
    assert profile.contact == Contact(margin_db=4.0)
    assert profile.contact.elements == STORED_ELEMENTS
    assert profile.bursts.mean_ms == 40
    assert profile.bursts.gap_s == base.bursts.gap_s
    assert profile.blackouts == (
        Blackout(start_s=60.0, seconds=2.5),
        Blackout(start_s=90.0, seconds=1.0, direction="uplink"),
    )
    assert profile.random_blackouts == RandomBlackouts(gap_s=30.0, shortest_s=0.1, longest_s=1.0)


def test_a_table_can_be_switched_off(load):
    assert load('base = "iss-pass"\nbursts = false').bursts is None


def test_own_elements_are_found_beside_the_file(load, tmp_path):
    (tmp_path / "sat.tle").write_text(STORED_ELEMENTS)
    profile = load('[contact]\nelements = "sat.tle"\nafter = "2015-08-19T00:00:00Z"')
    assert profile.contact.elements == STORED_ELEMENTS
    assert profile.contact_windows().acquisition.startswith("2015-08-19T")


@pytest.mark.rule("7")
@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("dely_ms = 5", "unknown field dely_ms: the nearest one is delay_ms"),
        ("[bursts]\nmean_s = 1", "unknown field bursts.mean_s: the nearest one is bursts.mean_ms"),
        ('base = "iss"', "geo, lte, wifi, satellite, bad-day, not 'iss'"),
        ("base = 3", "base must be one of"),
        ('delay_ms = "5"', "delay_ms must be a number"),
        ("bursts = 3", "bursts must be a table with gap_s, mean_ms"),
        ('[[blackouts]]\nstart_s = 1\nseconds = 1\ndirection = "up"', "take both, uplink or"),
        ("[random_blackouts]\ngap_s = 9\nshortest_s = 2\nlongest_s = 1", "from 2 to"),
        ("[contact]\nafter = 2015-08-18T14:00:00Z", "contact.after must be a text in quotes"),
        ('[contact]\nafter = "tomorrow"', 'write it like "2015-08-18T14:00:00Z"'),
        ("delay_ms = ", "is not TOML"),
    ],
)
def test_each_mistake_is_one_line(load, text, message):
    with pytest.raises(ConfigError, match=re.escape(message)) as caught:
        load(text)
    assert "\n" not in str(caught.value)
    assert "mine.toml" in str(caught.value)


def test_unknown_names_and_missing_files_are_refused(tmp_path):
    with pytest.raises(ConfigError, match="unknown radio iss: take cable, clean, iss-pass"):
        load_radio("iss")
    with pytest.raises(ConfigError, match="cannot read radio"):
        load_radio(str(tmp_path / "none.toml"))
    (tmp_path / "binary.toml").write_bytes(b"\xff\xfe")
    with pytest.raises(ConfigError, match="is not TOML"):
        load_radio(str(tmp_path / "binary.toml"))


def test_missing_or_wrong_elements_are_refused_when_the_file_is_read(load, tmp_path):
    with pytest.raises(ConfigError, match=r"mine\.toml: cannot read elements .*none\.tle"):
        load('[contact]\nelements = "none.tle"')
    (tmp_path / "bad.tle").write_text(STORED_ELEMENTS.replace("15239", "15238"))
    with pytest.raises(ConfigError, match=r"elements .*bad\.tle: checksum of line 1"):
        load('[contact]\nelements = "bad.tle"')
    with pytest.raises(ConfigError, match=r"contact\.elements must be a text in quotes, not 3"):
        load("[contact]\nelements = 3")


def test_the_annotated_profile_of_the_document_has_every_field(tmp_path):
    text = DOCUMENT.read_text(encoding="utf-8")
    found = re.findall(r"^```toml\n(# mine-radio.toml\n.*?)^```", text, re.MULTILINE | re.DOTALL)
    (block,) = found
    # Without a file of one's own, its line is a comment.
    table = tomllib.loads(block.replace("# elements", "elements"))
    assert set(table) == {field.name for field in fields(RadioProfile)} | {"base"}
    tables = {"bursts": Bursts, "random_blackouts": RandomBlackouts, "contact": Contact}
    tables["network"] = Network
    for name, kind in tables.items():
        assert set(table[name]) == {field.name for field in fields(kind)}, name
    assert set(table["blackouts"][0]) == {field.name for field in fields(Blackout)}
    # Its contact is the built-in pass.
    (tmp_path / "iss.tle").write_text(STORED_ELEMENTS)
    profile = radio_from_table(table, tmp_path)
    assert profile.contact == Contact()
