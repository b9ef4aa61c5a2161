"""The directory of an end: nothing outside of it, and no file that is not whole."""

import os
from itertools import product

import pytest

from pipelines.files.process_files import FencedDirectory
from telepresence.files.entity import LARGEST_LISTING, STORE, DirectoryJob
from telepresence.files.pdus import GET, LIST, REMOVE, RENAME, Key
from telepresence.files.sides import MAX_FILE_OCTETS

KEY = Key(1, 2, 3)


@pytest.fixture
def root(tmp_path):
    (tmp_path / "fence").mkdir()
    (tmp_path / "secret").write_bytes(b"secret")
    return tmp_path / "fence"


def do(root, kind, first, second="", octets=b""):
    return FencedDirectory(root).do(DirectoryJob(KEY, kind, first, second, octets))


def test_jobs_store_list_read_rename_and_remove(root):
    assert do(root, STORE, "a/b.bin", octets=b"12345") == ("", b"")
    assert do(root, STORE, "a/b.bin", octets=b"123") == ("", b"")
    assert do(root, LIST, "") == ("", f"{'':>10} a/\n".encode())
    assert do(root, LIST, "a") == ("", f"{3:>10} b.bin\n".encode())
    assert do(root, GET, "a/b.bin") == ("", b"123")
    assert do(root, RENAME, "a/b.bin", "c") == ("", b"")
    assert do(root, STORE, "d", octets=b"") == ("", b"")
    refusal, _ = do(root, RENAME, "c", "d")
    assert "already" in refusal
    assert do(root, REMOVE, "c") == ("", b"")
    for kind in (GET, REMOVE, RENAME):
        refusal, _ = do(root, kind, "c", "e")
        assert "no such file" in refusal
    assert do(root, LIST, "none")[0] == "no such file or directory"


@pytest.mark.rule("9")
def test_neither_dots_nor_links_lead_out(root):
    (root / "way").symlink_to(root.parent)
    (root / "link").symlink_to(root.parent / "secret")
    for name, kind in product(("../secret", "way/secret", "link"), (GET, REMOVE, RENAME, STORE)):
        refusal, octets = do(root, kind, name, "x", b"changed")
        assert refusal and octets == b""
    assert do(root, LIST, "way")[0]
    assert (root.parent / "secret").read_bytes() == b"secret"
    assert {path.name for path in root.iterdir()} == {"way", "link"}


def test_odd_entries_are_listed_and_refused_one_by_one(root):
    (root / "loop").symlink_to("loop")
    (root / "gone").symlink_to("nowhere")
    (root / "two\nlines").write_bytes(b"1")
    (root / os.fsdecode(b"latin\xe9")).write_bytes(b"12")
    os.mkfifo(root / "pipe")
    listed = {line.split(b" ")[-1]: line.split()[0] for line in do(root, LIST, "")[1].splitlines()}
    sizes = {b"two?lines": b"1", b"latin?": b"2", b"pipe": b"0", b"loop": b"?", b"gone": b"?"}
    assert listed == sizes
    for name, kind in product(("loop", "gone", "pipe", "loop/x", "a\0b"), (GET, REMOVE, RENAME)):
        assert do(root, kind, name, "x")[0]
    assert do(root, STORE, "loop", octets=b"1")[0] or (root / "loop").read_bytes() == b"1"
    (root / ".kontur-av-files").write_bytes(b"a user's own")
    assert do(root, STORE, "new", octets=b"1")[0]


def test_what_a_killed_process_began_to_write_goes_and_too_much_is_refused(root):
    theirs = [root / "a" / ".part-77", root / ".participants.csv", root / ".kontur-av-files/notes"]
    for path in (*theirs, root / ".kontur-av-files/part-77"):
        path.parent.mkdir(exist_ok=True)
        path.write_bytes(b"half")
    directory = FencedDirectory(root)
    assert not (root / ".kontur-av-files/part-77").exists()
    # Nobody else's file goes, whatever it is called, and hidden ones are nobody's to ask for.
    assert {path.read_bytes() for path in theirs} == {b"half"}
    assert directory.do(DirectoryJob(KEY, LIST, "a")) == ("", b"")
    assert directory.do(DirectoryJob(KEY, GET, "a/.part-77"))[0]
    with (root / "large").open("wb") as file:
        file.truncate(MAX_FILE_OCTETS + 1)
    assert "in parts" in do(root, GET, "large")[0]
    for number in range(500):
        (root / f"file{number}").touch()
    _, listing = do(root, LIST, "")
    assert len(listing) <= LARGEST_LISTING
    assert listing.decode().splitlines()[-1].startswith("and ")
