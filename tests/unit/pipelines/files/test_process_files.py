"""The directory of an end: nothing outside of it, and no file that is not whole."""

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


def test_what_a_killed_process_began_to_write_goes_and_too_much_is_refused(root):
    (root / "a").mkdir()
    (root / "a" / ".part-77").write_bytes(b"half")
    directory = FencedDirectory(root)
    assert list((root / "a").iterdir()) == []
    (root / "a" / ".part-78").write_bytes(b"half")
    assert directory.do(DirectoryJob(KEY, LIST, "a")) == ("", b"")
    assert directory.do(DirectoryJob(KEY, GET, "a/.part-78"))[0]
    with (root / "large").open("wb") as file:
        file.truncate(MAX_FILE_OCTETS + 1)
    assert "in parts" in do(root, GET, "large")[0]
    for number in range(500):
        (root / f"file{number}").touch()
    _, listing = do(root, LIST, "")
    assert len(listing) <= LARGEST_LISTING
    assert listing.decode().splitlines()[-1].startswith("and ")
