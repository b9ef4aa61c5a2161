"""AppLoader of the joystick's computer, step by step as in Figure 7 of Stelzer et al."""

import os
from random import Random

import pytest

from telepresence.upkeep.app_loader import (
    START_NS,
    WORKED_NS,
    AppLoader,
    BootDevice,
    CheckCopy,
    Copy,
    FindFtp,
    LoaderStep,
    LoadMode,
    Mode,
    NoteWorked,
    PowerOffReady,
    RebootFromFlash,
    StartApplication,
    StopApplication,
    StoreMode,
    WriteUpdate,
)

SD, FLASH = BootDevice.SD, BootDevice.FLASH
LIVES = int(os.environ.get("KONTUR_HISTORIES", "2000"))


class Computer:
    """What AppLoader runs on. invalid, broken: copies that fail their check, or their start."""

    def __init__(self, mode=Mode.PRIME, invalid=(), broken=(), ftp=True):
        self.mode, self.invalid, self.broken, self.ftp = mode, invalid, broken, ftp
        self.done = []
        self.running = self.loader = None
        self.off = False

    def boot(self, device=SD, now_ns=0):
        self.off, self.running = False, None
        self.loader = AppLoader(device, now_ns)

    def work(self, now_ns=0, steps=1000):
        """Do at most some events."""
        while steps and not self.off and (event := self.loader.next_event()) is not None:
            steps -= 1
            self.done.append(event)
            self.do(event, now_ns)

    def do(self, event, now_ns):
        loader = self.loader
        if isinstance(event, LoadMode):
            loader.handle_mode(self.mode, now_ns)
        elif isinstance(event, FindFtp):
            loader.handle_ftp(self.ftp, now_ns)
        elif isinstance(event, CheckCopy):
            loader.handle_checked(event.copy, "bad" if event.copy in self.invalid else None, now_ns)
        elif isinstance(event, StoreMode):
            self.mode = event.mode
            loader.handle_stored(now_ns)
        elif isinstance(event, StartApplication):
            self.running = event.copy
            if event.copy in self.broken:
                loader.handle_malfunction("broken", now_ns)
            else:
                loader.handle_started(now_ns)
        elif isinstance(event, StopApplication):
            self.running = None
            loader.handle_stopped(now_ns)
        elif isinstance(event, RebootFromFlash):
            self.boot(FLASH, now_ns)
        elif isinstance(event, WriteUpdate):
            self.mode = Mode.PRIME
            self.boot(now_ns=now_ns)
        elif isinstance(event, PowerOffReady):
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
    computer = booted(mode=mode)
    assert computer.done == [
        LoadMode(),
        CheckCopy(Copy.SD_1),
        CheckCopy(Copy.SD_2),
        StoreMode(next_mode),
        StartApplication(copy),
    ]


@pytest.mark.parametrize("mode", Mode)
def test_the_only_valid_copy_starts_and_is_desired(mode):
    computer = booted(mode=mode, invalid={Copy.SD_1})
    assert (computer.running, computer.mode) == (Copy.SD_2, Mode.BACKUP)


def test_without_a_valid_copy_on_the_card_it_boots_from_flash():
    computer = booted(invalid={Copy.SD_1, Copy.SD_2})
    assert RebootFromFlash() in computer.done
    assert computer.running is Copy.FTP_1


def test_from_flash_the_ftp_folders_are_prime_and_backup():
    assert booted(FLASH, mode=Mode.BACKUP).running is Copy.FTP_2
    without = booted(FLASH, ftp=False)
    assert (without.running, without.mode) == (Copy.FLASH, Mode.PRIME)
    assert not any(isinstance(event, CheckCopy) for event in without.done)


def test_with_both_ftp_folders_invalid_the_copy_in_flash_starts():
    computer = booted(FLASH, invalid={Copy.FTP_1, Copy.FTP_2})
    assert (computer.running, computer.mode) == (Copy.FLASH, Mode.PRIME)


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
    loader = AppLoader(SD, 0)
    loader.handle_mode(Mode.PRIME, 0)
    loader.handle_checked(Copy.SD_1, None, 0)
    loader.handle_checked(Copy.SD_2, None, 0)
    loader.handle_stored(0)
    assert loader.poll_timeout() == START_NS
    loader.handle_time(START_NS)
    assert loader.step is LoaderStep.STOP and loader.erroneous[Copy.SD_1]


def test_an_orderly_shutdown_keeps_the_copy_that_ran():
    computer = booted()
    computer.loader.handle_shutdown(5)
    computer.work(5)
    assert computer.done[-3:] == [StopApplication(), StoreMode(Mode.PRIME), PowerOffReady()]
    again = booted(mode=computer.mode)
    assert again.running is Copy.SD_1


@pytest.mark.parametrize("broken", [set(), {Copy.SD_1}])
def test_an_update_waits_for_an_orderly_end_and_is_tried_then(broken):
    computer = booted(mode=Mode.BACKUP)
    assert computer.running is Copy.SD_2
    computer.broken = broken
    computer.done.clear()
    computer.loader.handle_update(5)
    computer.work(5)
    assert computer.done[:4] == [
        StopApplication(),
        StoreMode(Mode.BACKUP),
        WriteUpdate(),
        LoadMode(),
    ]
    assert StartApplication(Copy.SD_1) in computer.done
    assert computer.running is (Copy.SD_2 if broken else Copy.SD_1)
    assert computer.mode is Mode.BACKUP


def test_power_off_goes_before_an_update():
    computer = booted()
    computer.loader.handle_update(5)
    computer.loader.handle_shutdown(5)
    computer.loader.handle_update(5)
    computer.work(5)
    assert computer.off and WriteUpdate() not in computer.done


def test_a_machine_that_hangs_and_is_switched_on_again_takes_the_other_copy():
    computer = booted()
    computer.boot()
    computer.work()
    assert computer.running is Copy.SD_2


def test_a_copy_that_has_run_for_a_minute_has_worked():
    computer = booted()
    computer.loader.handle_time(WORKED_NS)
    computer.work(WORKED_NS)
    assert computer.done[-1] == NoteWorked(Copy.SD_1)


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


def life(seed):
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
    on_card = sound in (Copy.SD_1, Copy.SD_2)
    computer.boot(SD if on_card or random.random() < 0.5 else FLASH, now_ns)
    if not on_card:
        # A copy on the card that starts is as good.
        computer.broken |= {Copy.SD_1, Copy.SD_2}
    computer.work(now_ns)
    return computer.running is not None and computer.running not in computer.broken


def test_whatever_fails_at_whatever_step_a_sound_copy_runs_in_the_end():
    assert [seed for seed in range(LIVES) if not life(seed)] == []
