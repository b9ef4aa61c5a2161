"""The analysis finds what differs, and says so of nothing more often than it promises."""

import numpy as np
import pytest

from pipelines.study.effects import Effect, helmert, holm, repeated_measures, study_report
from pipelines.study.plan import HandleLevels, StudyPlan, Tracking, TrialResult, trials_of

stats = pytest.importorskip("scipy.stats")

PLAN = StudyPlan(
    name="x",
    consent="Yes.",
    participants=12,
    handle=HandleLevels(stiffness_n_m=(0.0, 30.0), damping_n_s_m=(0.0, 5.0, 10.0)),
    tracking=(Tracking(name="spot"),),
    practice=1,
    trials=2,
)


def results_of(seed, *, damping=0.0):
    """Trials of people who differ, with noise that repeats itself for nobody.

    damping: what each N s/m of it adds to the error (m).
    """
    chance, found = np.random.default_rng(seed), []
    for participant in range(1, PLAN.participants + 1):
        own_m = chance.normal(0.008, 0.002)
        for number, one in enumerate(trials_of(PLAN, participant), 1):
            learned_m = 0.002 * np.exp(-number / 10)
            error_m = own_m + learned_m + chance.normal(0.0, 0.001)
            # Practice does not count, whatever it was.
            error_m += damping * one.condition.damping_n_s_m
            measured = {
                **dict.fromkeys(("difficulty_bits", "overshoot_m", "throughput_bit_s")),
                "seconds": 15.0,
                "path_m": chance.normal(1.0, 0.1),
                "rms_error_m": error_m if one.counts else 1.0,
                "force_mean_n": chance.normal(1.0, 0.1),
                "force_max_n": 2.0,
            }
            asked = {"place": one.place, "counts": one.counts, "repetition": one.repetition}
            did = {"participant": participant, "trial": number, "attempts": 1, "missed": 0}
            known = vars(one.condition) | measured | asked | did
            found.append(TrialResult(task="spot", note="", **known))
    return found


def test_two_levels_are_a_paired_t_test_and_who_is_not_through_is_left_out():
    values = np.random.default_rng(1).normal(size=(9, 2))
    f, df, df_error, p, _ = repeated_measures(values @ helmert(2))
    expected = stats.ttest_rel(values[:, 0], values[:, 1])
    assert (df, df_error) == pytest.approx((1, 8))
    assert (f, p) == pytest.approx((expected.statistic**2, expected.pvalue))
    base = {"task": "", "measure": "", "unit": "", "factor": "", "f": 1.0, "df": 1.0}
    tests = [Effect(**base, df_error=1.0, partial_eta2=0.0, p=p) for p in (0.04, 0.01, 0.03, 0.5)]
    assert [one.p_holm for one in holm(tests)] == pytest.approx([0.09, 0.04, 0.09, 0.5])
    report = study_report(PLAN, results_of(1))
    measures = {"error, root mean square", "path", "mean force"}
    assert {effect.measure for effect in report.effects} == measures
    results = results_of(1)
    report = study_report(PLAN, [one for one in results if (one.participant, one.trial) != (4, 18)])
    assert report.unfinished == (4,) and 4 not in report.participants
    assert len(report.participants) == 11


def test_an_effect_is_found_with_its_size_and_where_nothing_differs_few_reports_say_so():
    report = study_report(PLAN, results_of(3, damping=0.0004))
    (found,) = (effect for effect in report.effects if effect.differs)
    assert (found.measure, found.factor) == ("error, root mean square", "damping")
    assert found.levels["10"] - found.levels["0"] == pytest.approx(4.0, abs=0.8)
    assert found.partial_eta2 > 0.5 and 1.0 < found.df <= 2.0
    reports = [study_report(PLAN, results_of(seed)).effects for seed in range(30)]
    # 1.5 are expected of 30; more than 5 come by chance once in 200.
    assert sum(any(effect.differs for effect in effects) for effects in reports) <= 5
