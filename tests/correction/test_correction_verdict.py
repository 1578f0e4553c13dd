"""Whether a correction helps: closures left out in turn, and the sentence that says so."""

import numpy as np
import pytest

import raw_survey
from pointnetkl.correction.result import Verdict
from pointnetkl.correction.settings import Settings
from pointnetkl.correction.solution import verdict
from pointnetkl.correction.solution.verdict import Evidence
from pointnetkl.slam.closing import solving
from pointnetkl.slam.closing.estimate import Closure, Estimate, Tie

NAVIGATION = raw_survey.navigation(raw_survey.pings(lines=5))
START = Estimate(NAVIGATION.poses, NAVIGATION.covariance())
ROOT = np.linalg.cholesky(START.covariance)
PER_LINE = 7


def closure(source: int, shift: np.ndarray, sigma_m: float = 0.1, rank: int = 2) -> Closure:
    """Return the closure of a submap on its two neighbours of the line before, that moves it by a shift."""
    opposite = 2 * PER_LINE * (source // PER_LINE) - 1 - source
    tie = Tie.at(START.poses, source, sorted({opposite, max(opposite - 1, 0)}), None, np.array([3.0, 5.0]))
    A = np.eye(2)[:rank] / sigma_m
    return Closure(tie, A, A @ shift, 0.01, shift)


def drifted(seed: int, factor: float, noise_m: float = 0.1) -> list[Closure]:
    """Return the closures of a survey whose drift is so many times what is believed."""
    rng = np.random.default_rng([11, seed])
    errors = (ROOT @ rng.standard_normal(len(ROOT))).reshape(-1, 3)
    true = START.poses - factor * errors
    ties = [closure(source, np.zeros(2)) for source in range(PER_LINE, len(true) - 1)]
    return [closure(c.tie.source, c.tie.offset(true) + noise_m * rng.standard_normal(2)) for c in ties]


def judged(
    closures: list[Closure], disagreement: tuple[float, float] = (1.0, 0.5), found: int | None = None
) -> Verdict:
    count = len(closures) if found is None else found
    return verdict.judge(Evidence(START, closures, count, disagreement, 1.0, "as said"), Settings())


def test_what_is_left_out_is_predicted_as_by_a_solution_without_it():
    closures = drifted(0, 1.0)
    closures[3] = closure(closures[3].tie.source, np.array([0.5, 0.2]), rank=1)
    left = verdict.left_out(START, closures)
    for k, (own, one) in enumerate(zip(closures, left, strict=True)):
        others = solving.solve(START, [*closures[:k], *closures[k + 1 :]])
        assert one.before == pytest.approx(own.residual(START.poses))
        assert one.after == pytest.approx(own.residual(others.poses), abs=0.15, rel=0.02)  # of unit variance, curved
        unsure = own.A @ own.tie.variance(others) @ own.A.T + np.eye(own.rank)
        assert one.variance_after == pytest.approx(unsure, abs=0.05, rel=0.05)
        assert np.linalg.eigvalsh(one.variance_before - one.variance_after)[0] > -1e-9


def test_a_closure_alone_is_predicted_by_navigation():
    alone = closure(20, np.array([1.0, -2.0]))
    (one,) = verdict.left_out(START, [alone])
    assert one.after == pytest.approx(one.before)
    assert one.before == pytest.approx([-10.0, 20.0])
    assert one.gain == pytest.approx(0.0, abs=1e-9)


def test_nothing_left_out_is_nothing():
    assert verdict.left_out(START, []) == []


def test_rms_of_what_is_left_out_is_in_metres():
    shift = np.array([1.0, -2.0])
    found = judged([closure(source, shift) for source in range(10, 35, 3)])
    assert found.left_out_before_m == pytest.approx(np.linalg.norm(shift) / np.sqrt(2))  # of each of two directions


def test_directions_that_ground_hardly_holds_hardly_count():
    good, loose = closure(20, np.array([0.1, 0.1])), closure(30, np.array([30.0, 30.0]), sigma_m=100.0)
    assert judged([good, loose]).left_out_before_m < 0.15


@pytest.mark.parametrize("seed", range(5))
def test_a_drift_is_corrected(seed: int):
    found = judged(drifted(seed, 2.0))
    assert found.applied
    assert found.sentence.startswith("Corrected: loop closures that are left out fit to")
    assert found.left_out_p < 0.01
    assert found.left_out_after_m < 0.5 * found.left_out_before_m


@pytest.mark.parametrize("seed", range(5))
def test_closures_that_only_confirm_navigation_correct_nothing(seed: int):
    found = judged(drifted(seed, 0.0), (1.0, 0.99))
    assert not found.applied
    assert "agree with navigation" in found.sentence


def test_no_sentence_has_a_number_that_is_none():
    closures = drifted(0, 2.0)
    cases = [[], closures[:1], closures[:3], closures]
    for disagreement in ((1.0, 0.5), (np.nan, np.nan), (0.0, 0.0), (0.5, 1.0)):
        for some in cases:
            found = judged(some, disagreement, max(len(some), 1))
            assert "nan" not in found.sentence
            assert "\n" not in found.sentence
            assert found.sentence.endswith(".")


def test_a_correction_that_makes_overlaps_worse_is_not_applied():
    found = judged(drifted(0, 2.0), (0.5, 0.54))
    assert not found.applied
    assert "it would make the map worse" in found.sentence


def test_without_shared_cells_closures_decide():
    assert judged(drifted(0, 2.0), (np.nan, np.nan)).applied
    assert not judged(drifted(0, 0.0), (np.nan, np.nan)).applied


@pytest.mark.parametrize(("after", "applied"), [(0.79, True), (0.81, False)])
def test_of_few_closures_overlaps_decide(after: float, applied: bool):
    found = judged(drifted(0, 2.0)[:4], (1.0, after))
    assert found.applied is applied
    assert "4 of 4 returns" in found.sentence


@pytest.mark.parametrize("found", [0, 3])
def test_without_closures_it_says_why(found: int):
    said = judged([], found=found)
    assert not said.applied
    assert ("no part of the survey returns" if found == 0 else "of 3 returns") in said.sentence
    assert "1 return to" in judged([], found=1).sentence
    assert np.isnan([said.left_out_before_m, said.left_out_after_m, said.left_out_p]).all()


def test_closures_of_one_group_prove_nothing():
    shift = np.array([3.0, 0.0])
    found = judged([closure(21, shift), closure(22, shift), closure(23, shift)] * 2)
    assert np.isnan(found.left_out_p)
    assert not found.applied


def test_one_gross_closure_proves_nothing():
    closures = drifted(3, 0.0)
    closures[8] = closure(closures[8].tie.source, np.array([40.0, 0.0]))
    assert not judged(closures, (1.0, 0.9)).applied


def test_navigation_without_error_is_hardly_ever_corrected():
    applied = [judged(drifted(seed, 0.0), (1.0, 1.0)).applied for seed in range(60)]
    assert sum(applied) <= 3
