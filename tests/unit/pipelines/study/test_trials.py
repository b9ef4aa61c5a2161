"""A person is led through a study: what counts, what is begun again, where it goes on."""

from dataclasses import replace

import numpy as np
import pytest

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.errors import ConfigError
from pipelines.study.effects import study_report
from pipelines.study.plan import Aiming, HandleLevels, StudyPlan, Tracking
from pipelines.study.running import StudyFolder, write_tables
from pipelines.study.trials import StudyPhase, StudyPress, StudyTrials, check_handle
from telepresence.haptics.device.device import JoystickCapabilities, JoystickReading
from telepresence.haptics.device.page import PageDevice, PageInput

PLAN = StudyPlan(
    name="x",
    consent="Yes.",
    participants=2,
    handle=HandleLevels(damping_n_s_m=(0.0, 8.0)),
    tracking=(Tracking(name="spot", seconds=2.0),),
    practice=0,
    trials=2,
    break_s=20.0,
    break_every=1,
)


@pytest.fixture
def person():
    return Person()


class Person:
    """At the page of a desk, on virtual time; follows the target."""

    def __init__(self, plan=PLAN, finished=None):
        self.device = PageDevice(start_m=(0.0, 0.0))
        self.service = StudyTrials(plan, self.device, finished or {})
        self.now_ns = 5 * NS_PER_S
        self.service.handle_time(self.now_ns)
        self.sequence = 0
        self.x = self.y = 0.0

    @property
    def shown(self):
        return self.service.show(self.now_ns)

    def press(self, **other):
        self.service.handle_press(StudyPress(self.shown.screen, **other), self.now_ns)

    def hold(self, seconds, *, until=None):
        """Keep the dot on the target; return the results of trials that end."""
        found = []
        for _ in range(round(seconds * 100)):
            if until is not None and self.service.phase is until:
                break
            if (frame := self.service.frame) is not None:
                self.sequence += 1
                capabilities = self.device.capabilities
                # Corrects by a part of what is missing, so that damping is overcome.
                self.x += 0.08 * (frame.target_x_m - frame.x_m) / capabilities.half_width_m
                self.y += 0.08 * (frame.target_y_m - frame.y_m) / capabilities.half_height_m
                hand = PageInput(True, self.x, self.y, 0, self.sequence, self.now_ns)
                self.device.handle_input(hand)
            self.now_ns += 10 * NS_PER_MS
            self.service.handle_time(self.now_ns)
            found += iter(self.service.next_result, None)
        return found

    def begin(self):
        self.press()
        self.press()
        self.hold(10, until=StudyPhase.TRIAL)


def test_a_person_goes_through_all_trials_and_the_next_one_follows(person):
    assert person.service.phase is StudyPhase.CONSENT and PLAN.consent in person.shown.words
    old = person.shown.screen
    person.press()
    # A press of an older screen does nothing.
    person.service.handle_press(StudyPress(old), person.now_ns)
    assert person.service.phase is StudyPhase.READ
    person.press()
    person.hold(10, until=StudyPhase.TRIAL)
    results = person.hold(30, until=StudyPhase.BREAK)
    assert person.service.phase is StudyPhase.BREAK and 19.9 < person.shown.wait_s <= 20.0
    person.press()
    assert person.service.phase is StudyPhase.BREAK, "a break lasts"
    person.now_ns += 20 * NS_PER_S
    person.begin()
    results += person.hold(30, until=StudyPhase.DONE)
    found = [(result.participant, result.trial, result.attempts) for result in results]
    assert found == [(1, number, 1) for number in (1, 2, 3, 4)]
    assert all(result.rms_error_m < 0.02 and result.seconds is None for result in results)
    assert {result.damping_n_s_m for result in results if result.force_max_n > 0.0} == {8.0}
    assert person.shown.main == "Next person"
    person.press()
    assert person.service.phase is StudyPhase.CONSENT and "participant 2" in person.shown.words[1]


def test_who_lets_go_is_silent_or_busy_begins_the_trial_again_and_it_is_counted(person):
    person.begin()
    person.hold(0.5)
    person.device.handle_input(PageInput(False, 0.0, 0.0))
    person.now_ns += 10 * NS_PER_MS
    person.service.handle_time(person.now_ns)
    assert person.service.phase is StudyPhase.START
    assert person.shown.words[0] == "The handle was let go, so this trial begins again."
    (first, *_) = person.hold(12)
    assert (first.trial, first.attempts) == (1, 2)
    for silence_ns, steps in ((10 * NS_PER_MS, 15), (150 * NS_PER_MS, 1)):
        person = Person()
        person.begin()
        assert person.service.phase is StudyPhase.TRIAL
        for _ in range(steps):
            person.now_ns += silence_ns
            person.service.handle_time(person.now_ns)
        assert person.service.phase is StudyPhase.START, silence_ns


def test_an_interrupted_study_goes_on_and_a_stiff_handle_pushes_back():
    person = Person(finished={1: 3})
    assert person.service.phase is StudyPhase.RETURN and person.shown.trial == 3
    person.begin()
    (last,) = person.hold(12, until=StudyPhase.DONE)
    assert (last.participant, last.trial) == (1, 4)
    person = Person(finished={1: 3})
    person.press(other=True)
    assert person.service.phase is StudyPhase.CONSENT and "participant 2" in person.shown.words[1]
    assert Person(finished={1: 4, 2: 4}).service.phase is StudyPhase.DONE
    levels = HandleLevels(stiffness_n_m=(40.0,), inertia_kg=(0.5, 0.0))
    aiming = (Aiming(name="still", targets=5, width_m=0.03),)
    plan = StudyPlan(name="x", consent="Yes.", participants=2, handle=levels, aiming=aiming)
    person = Person(plan)
    person.begin()
    first, second = person.hold(60)[:2]
    # At 50 mm the spring has 2 N; it is never without.
    assert 1.0 < first.force_mean_n < 8.0
    assert first.throughput_bit_s is not None and second.attempts == 1
    assert person.device.joystick.virtual_kg == first.inertia_kg


def test_trials_are_on_the_disk_at_once_and_a_torn_line_is_none(person, tmp_path):
    person.begin()
    results = person.hold(30, until=StudyPhase.BREAK)
    with StudyFolder(tmp_path, PLAN) as folder:
        for result in results:
            folder.add(result)
            lines = (tmp_path / "trials.jsonl").read_bytes().splitlines()
            assert len(lines) == 1 + len(folder.results)
        with pytest.raises(ConfigError, match="another command has this study"):
            StudyFolder(tmp_path, PLAN)
    with (tmp_path / "trials.jsonl").open("ab") as file:
        file.write(b'{"participant": 1, "tri')
    with StudyFolder(tmp_path, PLAN) as folder:
        assert folder.results == results and folder.finished == {1: 2}
        folder.add(results[0])
    with StudyFolder(tmp_path, PLAN) as folder:
        assert folder.results == [*results, results[0]]
    with pytest.raises(ConfigError, match="is of people: name another folder"):
        StudyFolder(tmp_path, PLAN, simulated=True)
    with pytest.raises(ConfigError, match="with another plan"):
        StudyFolder(tmp_path, replace(PLAN, seed=9))


def test_tables_hold_every_trial_with_none_as_nan(person, tmp_path):
    loadmat = pytest.importorskip("scipy.io").loadmat
    person.begin()
    results = person.hold(30, until=StudyPhase.BREAK)
    paths = write_tables(tmp_path, results, study_report(PLAN, results))
    names = ["trials.csv", "effects.csv", "study.mat", "report.html"]
    assert [path.name for path in paths] == names
    rows = (tmp_path / "trials.csv").read_text().splitlines()
    assert rows[0].startswith("participant,trial,place,stiffness_n_m") and len(rows) == 3
    trials = loadmat(tmp_path / "study.mat", simplify_cells=True)["trials"]
    assert list(trials["task"]) == ["spot", "spot"] and np.isnan(trials["throughput_bit_s"]).all()
    assert np.allclose(trials["rms_error_m"], [result.rms_error_m for result in results])
    assert "no effects: at least 3 participants" in (tmp_path / "report.html").read_text()


class MotorHandle:
    """A handle that a hand carries to where the study asks; its motors are a real device's."""

    def __init__(self, **more):
        kind = {"name": "motors", "half_width_m": 0.1, "half_height_m": 0.1, "force_limit_n": 15.0}
        self.capabilities = JoystickCapabilities(**kind | more)
        self.place, self.speed, self.dead_man, self.forces = (0.0, 0.0), 0.0, True, []

    def read(self):
        return JoystickReading(*self.place, self.speed, 0.0, dead_man=self.dead_man)

    def write_force(self, x_n, y_n):
        self.forces.append((x_n, y_n))

    def show_state(self, state): ...

    def advance(self, dt_ns): ...


def test_a_handle_with_motors_takes_part_and_is_without_force_when_it_is_let_go():
    device = MotorHandle()
    check_handle(PLAN, device)
    service, now_ns = StudyTrials(PLAN, device, {}), 5 * NS_PER_S
    service.handle_time(now_ns)
    for _ in range(2):
        service.handle_press(StudyPress(service.show(now_ns).screen), now_ns)
    results = []
    for step in range(4000):
        now_ns += NS_PER_MS
        if (frame := service.frame) is not None:
            device.place, device.speed = (frame.target_x_m, frame.target_y_m), 0.25
        device.dead_man = step > 100
        service.handle_time(now_ns)
        results += iter(service.next_result, None)
    assert len(results) == 1
    damped = service.trial.planned.condition.damping_n_s_m
    assert set(device.forces[:100]) == {(0.0, 0.0)}
    assert (-0.25 * damped, 0.0) in device.forces and damped in (0.0, 8.0)


@pytest.mark.parametrize(
    ("plan", "more", "fix"),
    [
        (PLAN, {"force_limit_n": 0.0}, "no motors"),
        (replace(PLAN, handle=HandleLevels(inertia_kg=(0.0, 1.0))), {}, "inertia_kg out"),
        (PLAN, {"half_height_m": 0.05}, "bring them closer"),
        (
            replace(PLAN, handle=HandleLevels(stiffness_n_m=(0.0, 90.0))),
            {"force_limit_n": 3.0},
            "5",
        ),
    ],
)
def test_a_handle_that_cannot_take_part_is_refused_with_the_reason(plan, more, fix):
    with pytest.raises(ConfigError, match=fix):
        check_handle(plan, MotorHandle(**more))
