"""AppLoader of the joystick's computer, step by step as in Figure 7 of Stelzer et al.

Power may fail at any octet that is written: a whole copy is left.
"""

from random import Random

import pytest
from common import first_seed, repeats
from failing_disk import FailingDisk, PowerFailedError, software

from kontur_av.errors import ConfigError
from telepresence.upkeep import app_loader as loader
from telepresence.upkeep.app_loader import (
    START_NS,
    WORKED_NS,
    BootDevice,
    CheckCopy,
    Copy,
    LoadMode,
    Mode,
    PowerOffReady,
    RebootFromFlash,
    StartApplication,
    StopApplication,
    StoreMode,
    WriteUpdate,
    bootable,
    copy_to_backup,
    note_worked,
    store_mode,
    update_prime,
)
from telepresence.upkeep.file_store import StoredFile
from telepresence.upkeep.manifest import SFV, write_copy

SD, FLASH = BootDevice.SD, BootDevice.FLASH
BOTH = {Copy.SD_1, Copy.SD_2}


class Computer:
    """What AppLoader runs on. invalid, broken: copies that fail their check, or their start."""

    def __init__(self, mode=Mode.PRIME, invalid=(), broken=(), ftp=True):
        self.mode, self.invalid, self.broken, self.ftp = mode, invalid, broken, ftp
        self.done = []
        self.running = self.loader = None
        self.off = False

    def boot(self, device=SD, now_ns=0):
        self.off, self.running = False, None
        self.loader = loader.AppLoader(device, now_ns)

    def work(self, now_ns=0, steps=1000):
        """Do at most some events."""
        while steps and not self.off and (event := self.loader.next_event()) is not None:
            steps -= 1
            self.done.append(event)
            self.do(event, now_ns)

    def do(self, event, now_ns):
        match event:
            case LoadMode():
                self.loader.handle_mode(self.mode, now_ns)
            case loader.FindFtp():
                self.loader.handle_ftp(self.ftp, now_ns)
            case CheckCopy(copy):
                self.loader.handle_checked(copy, "bad" if copy in self.invalid else None, now_ns)
            case StoreMode(mode):
                self.mode = mode
                self.loader.handle_stored(now_ns)
            case StartApplication(copy):
                self.running = copy
                if copy in self.broken:
                    self.loader.handle_malfunction("broken", now_ns)
                else:
                    self.loader.handle_started(now_ns)
            case StopApplication():
                self.running = None
                self.loader.handle_stopped(now_ns)
            case RebootFromFlash():
                self.boot(FLASH, now_ns)
            case WriteUpdate():
                self.mode = Mode.PRIME
                self.boot(now_ns=now_ns)
            case PowerOffReady():
                self.off = True


def booted(device=SD, **how):
    computer = Computer(**how)
    computer.boot(device)
    computer.work()
    return computer


@pytest.mark.parametrize(
    ("mode", "copy", "next_mode"),
    [
        (Mode.PRIME, Copy.SD_1, Mode.BACKUP),
        (Mode.BACKUP, Copy.SD_2, Mode.PRIME),
        (None, Copy.SD_1, Mode.BACKUP),
    ],
)
def test_of_two_valid_copies_the_desired_one_starts_and_the_other_is_desired(mode, copy, next_mode):
    checks = [CheckCopy(Copy.SD_1), CheckCopy(Copy.SD_2)]
    begun = [LoadMode(), *checks, StoreMode(next_mode), StartApplication(copy)]
    computer = booted(mode=mode)
    assert computer.done == begun
    # The machine hangs, and is switched on again.
    computer.boot()
    computer.work()
    assert {computer.running, copy} == BOTH


@pytest.mark.parametrize(
    ("device", "how", "running", "desired"),
    [
        (SD, {"invalid": {Copy.SD_1}}, Copy.SD_2, Mode.BACKUP),
        (SD, {"invalid": {Copy.SD_1}, "mode": Mode.BACKUP}, Copy.SD_2, Mode.BACKUP),
        # Without a valid copy on the card it boots from flash.
        (SD, {"invalid": BOTH}, Copy.FTP_1, Mode.BACKUP),
        (FLASH, {"mode": Mode.BACKUP}, Copy.FTP_2, Mode.PRIME),
        (FLASH, {"ftp": False}, Copy.FLASH, Mode.PRIME),
        (FLASH, {"invalid": {Copy.FTP_1, Copy.FTP_2}}, Copy.FLASH, Mode.PRIME),
    ],
)
def test_the_first_copy_that_is_valid_starts(device, how, running, desired):
    computer = booted(device, **how)
    assert (computer.running, computer.mode) == (running, desired)
    assert (RebootFromFlash() in computer.done) is (how.get("invalid") == BOTH)
    checked = any(isinstance(event, CheckCopy) for event in computer.done)
    assert checked is how.get("ftp", True)


def test_a_copy_that_fails_at_its_start_is_marked_and_the_other_starts():
    computer = booted(broken={Copy.SD_1})
    assert computer.done[-4:] == [
        StartApplication(Copy.SD_1),
        StopApplication(),
        StoreMode(Mode.BACKUP),
        StartApplication(Copy.SD_2),
    ]
    assert computer.loader.erroneous == {Copy.SD_1: "broken"}


def test_a_copy_that_never_says_that_it_started_fails():
    silent = loader.AppLoader(SD, 0)
    silent.handle_mode(Mode.PRIME, 0)
    for copy in (Copy.SD_1, Copy.SD_2):
        silent.handle_checked(copy, None, 0)
    silent.handle_stored(0)
    assert silent.poll_timeout() == START_NS
    silent.handle_time(START_NS)
    assert silent.step is loader.LoaderStep.STOP and silent.erroneous[Copy.SD_1]


def test_an_orderly_shutdown_keeps_the_copy_that_ran_and_goes_before_an_update():
    computer = booted()
    computer.loader.handle_update(5)
    computer.loader.handle_shutdown(5)
    computer.loader.handle_update(5)
    computer.work(5)
    assert computer.done[-3:] == [StopApplication(), StoreMode(Mode.PRIME), PowerOffReady()]
    assert computer.off and booted(mode=computer.mode).running is Copy.SD_1


@pytest.mark.parametrize("broken", [set(), {Copy.SD_1}])
def test_an_update_waits_for_an_orderly_end_and_is_tried_then(broken):
    computer = booted(mode=Mode.BACKUP)
    assert computer.running is Copy.SD_2
    computer.broken = broken
    computer.done.clear()
    computer.loader.handle_update(5)
    computer.work(5)
    ended = [StopApplication(), StoreMode(Mode.BACKUP), WriteUpdate(), LoadMode()]
    assert computer.done[:4] == ended
    assert StartApplication(Copy.SD_1) in computer.done
    assert computer.running is (Copy.SD_2 if broken else Copy.SD_1)
    assert computer.mode is Mode.BACKUP


def test_a_copy_that_has_run_for_a_minute_has_worked():
    computer = booted()
    computer.loader.handle_time(WORKED_NS)
    computer.work(WORKED_NS)
    assert computer.done[-1] == loader.NoteWorked(Copy.SD_1)


def test_the_copy_in_flash_is_tried_again_and_again():
    computer = booted(FLASH, ftp=False, broken={Copy.FLASH})
    pauses, now_ns = [], 0
    for _ in range(8):
        due_ns = computer.loader.poll_timeout()
        pauses.append((due_ns - now_ns) // 10**9)
        now_ns = due_ns
        computer.loader.handle_time(now_ns)
        computer.work(now_ns)
    assert pauses == [1, 2, 4, 8, 16, 32, 60, 60]


def boot_id(seed):
    """Faults and power cuts at any step of many boots, then a quiet one: whether all is well."""
    random = Random(seed)
    copies = list(Copy)
    computer = Computer(mode=random.choice([*Mode, None]))
    sound = random.choice(copies)
    now_ns = 0
    for _ in range(random.randint(1, 6)):
        # An update may be broken in any way; one copy of all is sound.
        computer.invalid = {each for each in copies[:4] if random.random() < 0.4} - {sound}
        computer.broken = {each for each in copies if random.random() < 0.4} - {sound}
        computer.ftp = sound in (Copy.FTP_1, Copy.FTP_2) or random.random() < 0.5
        computer.boot(random.choice(list(BootDevice)), now_ns)
        for _ in range(random.randint(0, 12)):
            now_ns += random.choice((0, 1, START_NS, WORKED_NS))
            computer.work(now_ns, steps=random.randint(0, 3))
            fault = random.random()
            if computer.off:
                break
            if fault < 0.2:
                computer.loader.handle_malfunction("fault", now_ns)
            elif fault < 0.3:
                computer.loader.handle_shutdown(now_ns)
            elif fault < 0.4:
                computer.loader.handle_update(now_ns)
            else:
                computer.loader.handle_time(now_ns)
    on_card = sound in BOTH
    computer.boot(SD if on_card or random.random() < 0.5 else FLASH, now_ns)
    if not on_card:
        # A copy on the card that starts is as good.
        computer.broken |= BOTH
    computer.work(now_ns)
    return computer.running is not None and computer.running not in computer.broken


def test_whatever_fails_at_whatever_step_a_sound_copy_runs_in_the_end():
    seeds = range(first_seed(0), first_seed(0) + repeats(1000))
    assert [seed for seed in seeds if not boot_id(seed)] == []


def copies_disk(random):
    disk = FailingDisk()
    for copy in (Copy.SD_1, Copy.SD_2):
        write_copy(disk, copy.value, software(random, "first"))
    store_mode(disk, random.choice(list(Mode)))
    note_worked(disk, Copy.SD_1)
    return disk


def damage(disk, *copies):
    for copy in copies:
        disk.content[f"{copy}/run"] = (b"#!/bin/sh\n# damaged\n", True)


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
    for seed in range(first_seed(0) + part, first_seed(0) + repeats(400), 4):
        random = Random(seed)
        disk = copies_disk(random)
        disk.fuse = Random(-1 - seed).randrange(1, 2000)
        try:
            maintain(disk, Random(seed))
        except PowerFailedError:
            disk = disk.powered_again()
        assert bootable(disk, SD), seed
        assert loader.read_mode(disk) in Mode, seed
        # Maintenance goes on from there.
        disk.fuse = None
        if bootable(disk, SD) == [Copy.SD_1]:
            note_worked(disk, Copy.SD_1)
            copy_to_backup(disk, SD)
        update_prime(disk, software(random, "last"), SD)
        assert len(bootable(disk, SD)) == 2, seed


def test_one_of_both_copies_stays_until_the_other_has_worked():
    random = Random(1)
    disk = copies_disk(random)
    update_prime(disk, software(random, "second"), SD)
    with pytest.raises(ConfigError, match="has not worked yet"):
        copy_to_backup(disk, SD)
    note_worked(disk, Copy.SD_1)
    copy_to_backup(disk, SD)
    assert disk.read("sd/2/run") == disk.read("sd/1/run")
    damage(disk, "sd/2")
    with pytest.raises(ConfigError, match="backup is invalid"):
        update_prime(disk, software(random, "third"), SD)
    # Where no copy is whole, prime is written.
    damage(disk, "sd/1")
    update_prime(disk, software(random, "third"), SD)
    assert bootable(disk, SD) == [Copy.SD_1]


def test_the_cyclic_check_of_the_flash_finds_damage_within_a_round_and_a_sound_round_ends_it():
    disk, now_ns = FailingDisk(), 0
    write_copy(disk, "flash", {name: StoredFile(name.encode()) for name in ("run", "a", "lib/b")})
    check = loader.FlashCheck(disk, "flash", 0, 10)

    def after_rounds(number):
        nonlocal now_ns
        # It reads the list, then one file a time.
        for _ in range(number * 4):
            now_ns = check.poll_timeout()
            check.handle_time(now_ns)
        return check.metrics

    metrics = after_rounds(2)
    assert (metrics.rounds, metrics.files_checked, metrics.errors) == (2, 6, 0)
    assert metrics.sound and now_ns == 70
    whole = disk.content["flash/a"]
    disk.content["flash/a"] = (b"damaged", False)
    metrics = after_rounds(1)
    assert (metrics.sound, metrics.last_error) == (False, "a: damaged")
    disk.content["flash/a"] = whole
    assert after_rounds(1).sound
    disk.remove(f"flash/{SFV}")
    assert not after_rounds(1).sound


def test_a_loader_that_has_not_started_has_no_unreadable_mode():
    disk = copies_disk(Random(0))
    disk.content.pop("eeprom", None)
    assert loader.mode_words(disk) == "prime: it has not started yet"
    loader.store_mode(disk, Mode.BACKUP)
    assert loader.mode_words(disk) == "backup"
    disk.write("eeprom", b"?")
    assert loader.mode_words(disk) == "unreadable: prime is taken"
