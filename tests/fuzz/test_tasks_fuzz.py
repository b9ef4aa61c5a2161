"""Any octets as a file of tasks: a catalogue, or one ConfigError. The schema refuses as much."""

import re
from random import Random

import pytest
from common import first_seed, repeats
from hypothesis import given
from hypothesis import strategies as st

from kontur_av.errors import ConfigError
from telepresence.tasks.reader import read_tasks
from telepresence.tasks.task_files import BUILT_IN, SCHEMA, built_in_tasks

CATALOGUE = BUILT_IN.read_bytes()
#: What a reader must be able to bear in the place of a value.
VALUES = ["", " ", "0", "-1", "8", "1e3", "nan", "601", " 5 ", "true", "leds", "0 1", "é", "&#0;"]
WORDS = [b"<", b"/>", b'"', b"&", b"<!DOCTYPE a [", b"<![CDATA[", b"]]>", b"\xff", b"\x00", b"-->"]
SMALL = b"""<Tasks>
  <Show name="light" leds="3"/>
  <Reach name="reach" led="3" within_mm="3" hold_s="1" timeout_s="30"/>
  <Operation name="startMine">
    <Elemop ref="powerOff"/><Elemop ref="positionControl"/><Elemop ref="powerOn"/>
    <Elemop ref="light"/><Elemop ref="homePosition"/>
  </Operation>
  <Operation name="execMine">
    <Elemop ref="powerOff"/><Elemop ref="telePresenceControl"/><Elemop ref="powerOn"/>
    <Elemop ref="reach"/><Elemop ref="powerOff"/>
  </Operation>
  <Task name="mine" start="startMine" exec="execMine" start_x_mm="-45" start_y_mm="0"
    text="Reach it."/>
</Tasks>"""


def read(octets, *known):
    try:
        return read_tasks(octets, *known)
    except ConfigError as error:
        assert "\n" not in str(error)
        return None


@given(st.binary(max_size=200))
def test_any_octets_are_read_or_refused(octets):
    read(octets)
    read(b"<Tasks>" + octets + b"</Tasks>")


@given(st.data())
def test_what_the_schema_refuses_the_reader_refuses(data):
    etree = pytest.importorskip("lxml.etree", reason="lxml reads the schema")
    schema = etree.XMLSchema(etree.parse(SCHEMA))
    text = CATALOGUE.decode()
    places = list(re.finditer(r'(?<= )([a-z_]+)="([^"]*)"', text))[3:]
    place = data.draw(st.sampled_from(places))
    value = data.draw(st.sampled_from(VALUES))
    changed = f"{text[: place.start(2)]}{value}{text[place.end(2) :]}".encode()
    try:
        valid = schema.validate(etree.fromstring(changed))
    except etree.XMLSyntaxError:
        valid = False
    if not valid:
        assert read(changed) is None


def test_many_mutations_of_a_file_raise_nothing_else():
    seed, mutations = first_seed(), repeats(2000)
    random, known, taken = Random(seed), built_in_tasks(), 0
    assert read(SMALL, known).tasks["mine"]
    words = [*WORDS, *(value.encode() for value in VALUES)]
    for _ in range(mutations):
        octets = bytearray(SMALL)
        for _ in range(random.randint(1, 3)):
            place = random.randrange(len(octets) + 1)
            new = random.choice(words) if random.random() < 0.5 else random.randbytes(1)
            octets[place : place + random.randint(0, 6)] = new
        taken += read(bytes(octets), known) is not None
    assert 0 < taken < mutations, f"seed {seed}"
