"""Updates and orders that come as files: what is taken, when, and what is refused."""

import gzip
import tarfile
from io import BytesIO

import pytest

from kontur_av.clock import NS_PER_S
from kontur_av.errors import ConfigError
from telepresence.upkeep import inbox as inboxes
from telepresence.upkeep.file_store import StoredFile
from telepresence.upkeep.inbox import REST_NS, UpdateInbox, read_archive

RUN = StoredFile(b"#!/bin/sh\n", executable=True)


def archive(*members, kind=tarfile.REGTYPE, link=""):
    """members: pairs of path and octets."""
    out = BytesIO()
    with tarfile.open(fileobj=out, mode="w") as tar:
        for name, octets in members:
            about = tarfile.TarInfo(name)
            about.type, about.linkname = kind, link
            about.size, about.mode = len(octets), 0o755
            tar.addfile(about, BytesIO(octets))
    return out.getvalue()


def headers(*members):
    """Members that only say something about the next one: pairs of type and octets."""
    out = b""
    for kind, octets in members:
        about = tarfile.TarInfo("@")
        about.type, about.size = kind, len(octets)
        out += about.tobuf() + octets.ljust(512, b"\0")
    return out


def test_an_archive_is_read_plain_and_compressed():
    plain = archive(("./run", RUN.octets), ("lib/a", b""))
    files = {"run": RUN, "lib/a": StoredFile(b"", executable=True)}
    assert read_archive(plain) == files
    assert read_archive(gzip.compress(plain)) == files


@pytest.mark.parametrize(
    "octets",
    [
        b"",
        b"no archive" * 100,
        archive(("run", bytes(2000)))[:1500],
        gzip.compress(archive(("run", b"x")))[:-9],
        archive(("/etc/passwd", b"")),
        archive(("a/../../b", b"")),
        *(archive((name, b"")) for name in ("a\nb", ";a", "a ", " a")),
        archive(("a", b""), ("./a", b"")),
        archive(("a", b""), ("a/b", b"")),
        archive(("a", b""), kind=tarfile.SYMTYPE, link="/etc/passwd"),
        archive(("a", b""), kind=tarfile.LNKTYPE, link="b"),
        archive(("a", b""), kind=tarfile.FIFOTYPE),
        archive(*((str(number), b"") for number in range(1001))),
        gzip.compress(bytes(65 << 20), 1),
        bytes(inboxes.MOST_ARCHIVE_OCTETS + 1),
        headers((tarfile.GNUTYPE_LONGNAME, b"a")) * 3000,
        headers((tarfile.GNUTYPE_LONGLINK, b"a")) * 3000,
        gzip.compress(headers((tarfile.XHDTYPE, b"10 path=a\n")) * 30_000),
        headers((tarfile.XGLTYPE, b"10 path=a\n")) * 3000,
        headers((tarfile.XHDTYPE, b"17 size=-5000000\n")) + archive(("run", b"")),
        headers((tarfile.XHDTYPE, b"99999999999999999999 a=b\n")) + archive(("run", b"")),
        archive(("a" * 256, b"")),
        archive(*((f"{'a' * 200}/" * 6 + "b", b"") for _ in "a")),
        archive(("log", b""), kind=tarfile.DIRTYPE),
        b"\x1f\x8b" + bytes(5000),
    ],
    ids=range(28),
)
def test_what_is_no_sound_archive_is_refused(octets):
    with pytest.raises(ConfigError, match="archive"):
        read_archive(octets)


def stamp(written_ns=1, octets=10):
    return inboxes.FileStamp(written_ns, 1, octets)


def test_a_file_is_taken_once_it_has_lain_still_the_oldest_first():
    inbox = UpdateInbox({"copy"})
    files = {"b.tar": stamp(1), "a.order": stamp(2), "c.bin": stamp(0), ".d.tar": stamp(0)}
    inbox.handle_files(files, 0)
    assert inbox.next_file(REST_NS - 1) is None
    inbox.handle_files(files | {"b.tar": stamp(1, 20)}, NS_PER_S)
    assert inbox.next_file(REST_NS) == "a.order"
    assert inbox.handle_done("a.order", "done", "") == "a.order.taken"
    assert inbox.next_file(REST_NS) is None
    assert inbox.next_file(NS_PER_S + REST_NS) == "b.tar"
    assert inbox.handle_done("b.tar", "", "why") == "b.tar.refused"
    # Where it cannot be renamed, it is not taken again.
    inbox.handle_files(files | {"b.tar": stamp(1, 20)}, 10 * REST_NS)
    assert inbox.next_file(20 * REST_NS) is None
    inbox.handle_files({"b.tar": stamp(3)}, 20 * REST_NS)
    assert inbox.next_file(21 * REST_NS) == "b.tar"


def test_nothing_is_taken_while_an_experiment_runs():
    inbox = UpdateInbox({"copy"})
    inbox.handle_files({"b.tar.gz": stamp()}, 0)
    inbox.handle_busy(True)
    assert inbox.next_file(REST_NS) is None
    assert b'"busy": true' in inbox.told("v1", "", {})
    inbox.handle_busy(False)
    assert inbox.next_file(REST_NS) == "b.tar.gz"


def test_answers_outlive_the_keeper_and_are_few():
    inbox = UpdateInbox({"copy"}, b"no JSON")
    for number in range(100):
        inbox.handle_done(f"{number}.tar", "", "why" * 1000)
    told = inbox.told("v1", "power on", {"v1": "new"})
    assert len(told) < 10_000
    assert UpdateInbox({"copy"}, told).told("v1", "power on", {"v1": "new"}) == told
    # What the other end could have put in its place.
    empty = UpdateInbox({"copy"}).told("v1", "power on", {"v1": "new"})
    for garbage in (b'{"runs": "\xff"}', b'{"more": ' + b"[" * 60_000):
        assert UpdateInbox({"copy"}, garbage).told("v1", "power on", {"v1": "new"}) == empty


def test_only_an_allowed_order_is_one():
    inbox = UpdateInbox({"start", "copy"})
    assert inbox.order_of(b" start  v2\n") == "start v2"
    for octets in (b"", b"\n", b"shutdown", b"\xff", b"start " + b"v" * 300):
        with pytest.raises(ConfigError, match="no order"):
            inbox.order_of(octets)
