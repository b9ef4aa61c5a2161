"""Lists of checksums: Debian's cksfv verifies ours, and we verify its."""

import subprocess

import pytest
from programs import needs

from pipelines.upkeep.requests import DiskStore
from telepresence.upkeep.file_store import StoredFile
from telepresence.upkeep.manifest import SFV, fault_of, write_copy

pytestmark = pytest.mark.interop
FILES = {
    "run": StoredFile(b"#!/bin/sh\n", executable=True),
    "lib/with a space.so": StoredFile(bytes(range(256)) * 99),
    "empty": StoredFile(b""),
}


@pytest.fixture(autouse=True)
def cksfv():
    needs("cksfv")


def verified(folder):
    done = subprocess.run(["cksfv", "-q", "-g", SFV], cwd=folder, capture_output=True, timeout=60)
    return done.returncode == 0


def test_cksfv_verifies_our_list(tmp_path):
    write_copy(DiskStore(tmp_path), "copy", FILES)
    assert verified(tmp_path / "copy")
    (tmp_path / "copy" / "run").write_bytes(b"#!/bin/sH\n")
    assert not verified(tmp_path / "copy")


def test_we_verify_the_list_of_cksfv(tmp_path):
    write_copy(DiskStore(tmp_path), "copy", FILES)
    folder = tmp_path / "copy"
    done = subprocess.run(
        ["cksfv", *FILES], cwd=folder, check=True, capture_output=True, timeout=60
    )
    (folder / SFV).write_bytes(done.stdout)
    store = DiskStore(tmp_path)
    assert fault_of(store, "copy") is None
    (folder / "lib" / "with a space.so").write_bytes(b"damaged")
    assert fault_of(store, "copy") == "its file lib/with a space.so is damaged"
