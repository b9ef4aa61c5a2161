"""The cyclic check of the flash finds damage within a round, and says when it is gone."""

from failing_disk import FailingDisk

from telepresence.upkeep.app_loader import FlashCheck
from telepresence.upkeep.file_store import StoredFile
from telepresence.upkeep.manifest import SFV, write_copy

FILES = {name: StoredFile(name.encode()) for name in ("run", "lib/a", "lib/b")}
#: It reads the list, then one file a time.
ROUND = 1 + len(FILES)


def test_damage_is_found_within_a_round_and_a_sound_round_ends_it():
    disk = FailingDisk()
    write_copy(disk, "flash", FILES)
    check = FlashCheck(disk, "flash", 0, 10)
    now_ns = 0

    def rounds(number):
        nonlocal now_ns
        for _ in range(number * ROUND):
            now_ns = check.poll_timeout()
            check.handle_time(now_ns)
        return check.figures

    figures = rounds(2)
    assert (figures.rounds, figures.files_checked, figures.errors) == (2, 6, 0)
    assert figures.sound and now_ns == (2 * ROUND - 1) * 10
    whole = disk.content["flash/lib/a"]
    disk.content["flash/lib/a"] = (b"damaged", False)
    figures = rounds(1)
    assert (figures.sound, figures.last_error) == (False, "lib/a: damaged")
    disk.content["flash/lib/a"] = whole
    assert rounds(1).sound
    disk.remove(f"flash/{SFV}")
    assert not rounds(1).sound
