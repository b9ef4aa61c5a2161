"""Power may fail at any octet that is written: a whole copy, and a version that starts, are left.

`KONTUR_CUTS=10000` draws as many as the claim has.
"""

import os
from random import Random

import pytest
from failing_disk import FailingDisk, PowerFailedError

from kontur_av.errors import ConfigError
from telepresence.link.protection.identity import MachineKey
from telepresence.upkeep.app_loader import (
    BootDevice,
    Copy,
    Mode,
    bootable,
    copy_to_backup,
    note_worked,
    read_mode,
    store_mode,
    update_prime,
)
from telepresence.upkeep.file_store import StoredFile
from telepresence.upkeep.manifest import MANIFEST, signed_manifest, write_copy
from telepresence.upkeep.version_stack import ELEMENTARY, VersionDirectory, VersionState

CUTS = int(os.environ.get("KONTUR_CUTS", "1000"))
KEY = MachineKey.from_seed(bytes(32))
SD = BootDevice.SD


def software(random, edition):
    """The files of an edition; some are equal in all, as libraries are."""
    files = {
        "run": StoredFile(f"#!/bin/sh\n# {edition}\n".encode(), executable=True),
        "lib/same.so": StoredFile(bytes(range(200))),
    }
    for number in range(random.randint(0, 3)):
        octets = random.randbytes(random.randint(0, 300))
        files[f"lib/{random.choice('abc')}{number}"] = StoredFile(octets)
    return files


def copies_disk(random):
    disk = FailingDisk()
    for copy in (Copy.SD_1, Copy.SD_2):
        write_copy(disk, copy.value, software(random, "first"))
    store_mode(disk, random.choice(list(Mode)))
    note_worked(disk, Copy.SD_1)
    return disk


def maintain(disk, random):
    """What operators and AppLoader do: update, boot, copy; each where it is allowed."""
    for edition in range(random.randint(1, 4)):
        try:
            if random.random() < 0.6:
                update_prime(disk, software(random, str(edition)), SD)
                if random.random() < 0.7:
                    note_worked(disk, Copy.SD_1)
            else:
                copy_to_backup(disk, SD)
        except ConfigError:
            continue
        store_mode(disk, random.choice(list(Mode)))


@pytest.mark.parametrize("part", range(4))
def test_a_power_cut_leaves_a_bootable_copy_and_a_mode(part):
    for seed in range(part, CUTS, 4):
        whole = copies_disk(Random(seed))
        maintain(whole, Random(seed))
        random = Random(seed)
        disk = copies_disk(random)
        disk.cost = 0
        disk.fuse = Random(-1 - seed).randrange(1, 2000)
        try:
            maintain(disk, Random(seed))
        except PowerFailedError:
            disk = disk.powered_again()
        assert bootable(disk, SD), seed
        assert read_mode(disk) in Mode, seed
        # Maintenance goes on from there.
        disk.fuse = None
        if bootable(disk, SD) == [Copy.SD_1]:
            note_worked(disk, Copy.SD_1)
            copy_to_backup(disk, SD)
        update_prime(disk, software(random, "last"), SD)
        assert len(bootable(disk, SD)) == 2


def versions_of(disk):
    return VersionDirectory(disk, {KEY.identity})


def signed(random, name):
    files = software(random, name)
    return {**files, MANIFEST: StoredFile(signed_manifest(name, files, KEY))}


def upkeep(disk, random):
    """Versions come, start, fail, work and go."""
    versions = versions_of(disk)
    for number in range(random.randint(1, 4)):
        record, name = versions.read(), f"v{number}"
        versions.add(name, signed(random, name))
        versions.store(record.added(name))
        versions.store(versions.read().ordered(name))
        record = versions.read()
        if random.random() < 0.5:
            versions.store(record.worked())
        else:
            versions.store(record.failed(defective=True))
            if random.random() < 0.5:
                versions.store(versions.read().removed(name))
                versions.forget(name)


@pytest.mark.parametrize("part", range(4))
def test_a_power_cut_leaves_a_version_that_starts(part):
    for seed in range(part, CUTS, 4):
        random = Random(seed)
        disk = FailingDisk()
        first = signed(random, ELEMENTARY)
        disk.fuse = Random(-1 - seed).randrange(1, 6000)
        try:
            versions_of(disk).add(ELEMENTARY, first)
            upkeep(disk, random)
        except PowerFailedError:
            disk = disk.powered_again()
        versions = versions_of(disk)
        versions.tidy()
        if not versions.has_elementary():
            versions.add(ELEMENTARY, first)
        record = versions.read()
        assert not [path for path in disk.files("") if "unfinished" in path]
        for name in (record.current, ELEMENTARY):
            versions.check(name)
        for name, state in record.versions:
            if state is not VersionState.DEFECTIVE:
                versions.check(name)


def test_backup_stays_until_prime_has_worked():
    random = Random(1)
    disk = copies_disk(random)
    update_prime(disk, software(random, "second"), SD)
    with pytest.raises(ConfigError, match="has not worked yet"):
        copy_to_backup(disk, SD)
    note_worked(disk, Copy.SD_1)
    copy_to_backup(disk, SD)
    assert disk.read("sd/2/run") == disk.read("sd/1/run")


def test_prime_stays_while_backup_is_damaged():
    disk = copies_disk(Random(1))
    disk.content["sd/2/run"] = (b"#!/bin/sh\n# damaged\n", True)
    with pytest.raises(ConfigError, match="backup is invalid"):
        update_prime(disk, software(Random(2), "second"), SD)


def test_prime_is_written_where_no_copy_is_whole():
    disk = copies_disk(Random(1))
    for copy in ("sd/1", "sd/2"):
        disk.content[f"{copy}/run"] = (b"#!/bin/sh\n# damaged\n", True)
    update_prime(disk, software(Random(2), "second"), SD)
    assert bootable(disk, SD) == [Copy.SD_1]


def test_a_version_that_came_twice_is_known_by_its_manifest():
    random, versions = Random(1), versions_of(FailingDisk())
    files, record = signed(random, "v1"), versions.read()
    assert not versions.holds("v1", files, record)
    versions.add("v1", files)
    # A power cut left it without a record.
    assert not versions.holds("v1", files, record)
    record = record.added("v1")
    assert versions.holds("v1", files, record)
    assert not versions.holds("v1", signed(random, "v1"), record)
    assert not versions.holds("v1", software(random, "v1"), record)


@pytest.mark.parametrize("path", ["run", "lib/same.so", MANIFEST])
def test_a_version_that_is_not_as_signed_is_refused(path):
    files = signed(Random(1), "v1")
    octets = bytearray(files[path].octets)
    octets[len(octets) // 2] ^= 1
    files[path] = StoredFile(bytes(octets), executable=path == "run")
    with pytest.raises(ConfigError, match=r"damaged|signature"):
        versions_of(FailingDisk()).add("v1", files)


def test_a_version_of_a_stranger_is_refused():
    versions = VersionDirectory(FailingDisk(), {MachineKey.from_seed(bytes([1] * 32)).identity})
    with pytest.raises(ConfigError, match="not trusted"):
        versions.add("v1", signed(Random(1), "v1"))


def test_a_manifest_nested_without_end_is_refused():
    files = signed(Random(1), "v1")
    files[MANIFEST] = StoredFile(b'{"more": ' + b"[" * 60_000, executable=False)
    with pytest.raises(ConfigError, match="manifest is damaged"):
        versions_of(FailingDisk()).add("v1", files)
