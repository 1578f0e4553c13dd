"""Truths of CELLO: what it remembers, in whose frame, and that no submap is judged by its own neighbours."""

import dataclasses

import numpy as np
import pytest

import terrains
from pointnetkl.methods import sampled
from pointnetkl.methods.fitted import cello, fitting
from pointnetkl.registration import gicp
from pointnetkl.registration.covariance import gaussian
from pointnetkl.surveys.submap import Submap
from toy_submaps import BOTH, FIT, LABEL, REGISTRATION, SETUP, assert_turns, rotation, submap, turned

KINDS = ("flat", "gentle", "mild", "rugged", "ridge")
BLOCKS = dataclasses.replace(FIT, blocks=2)


@pytest.fixture(scope="module")
def training() -> fitting.Training:
    """Return two passes over each of five seabeds, the second as another survey, with Monte Carlo labels."""
    submaps = [
        dataclasses.replace(submap(kind, number), survey=f"pass {number}", number=rank)
        for number in range(2)
        for rank, kind in enumerate(KINDS)
    ]
    label = sampled.Sampled("label", 200, 2, LABEL, REGISTRATION)
    return fitting.Training(submaps, np.stack([label.covariance(s) for s in submaps]), SETUP)


@pytest.fixture(scope="module")
def fit(training) -> fitting.Fit:
    """Return what it learns of them."""
    return cello.fit(training, BLOCKS)


def remembered(*labelled: tuple[Submap, np.ndarray], scale: float = 3.0, dof: str = "xy") -> cello.Cello:
    """Return it with these submaps and labels in its memory."""
    setup = BOTH[dof]
    looks = [cello.appearance_of(s, setup) for s, _ in labelled]
    variances = [np.diag(look.axes.T @ label @ look.axes) for look, (_, label) in zip(looks, labelled, strict=True)]
    features = np.stack([look.features for look in looks])
    return cello.Cello("cello", np.full(features.shape[1], scale), features, np.stack(variances), setup)


def test_a_remembered_submap_gets_nearly_its_own_label():
    labels = {kind: np.diag([9.0, 4.0]) / 8**rank for rank, kind in enumerate(KINDS)}
    method = remembered(*((submap(kind), label) for kind, label in labels.items()))
    for kind, label in labels.items():
        appearance = cello.appearance_of(submap(kind), SETUP)
        axes = appearance.axes
        own = axes * np.diag(axes.T @ label @ axes) @ axes.T
        np.testing.assert_allclose(method.covariance(submap(kind)), own, rtol=1e-3, atol=1e-5)


def test_a_ridge_in_another_direction_gets_the_label_turned():
    label = np.diag([6.0, 0.01])
    method = remembered(*((turned(submap("ridge"), a), rotation(a, 2) @ label @ rotation(a, 2).T) for a in (0.0, 1.3)))
    R = rotation(0.5, 2)
    np.testing.assert_allclose(method.covariance(turned(submap("ridge", 1), 0.5)), R @ label @ R.T, atol=0.2)


def test_the_mirror_image_gets_the_mirror_image():
    whole = submap("rugged")
    mirror = np.diag([1.0, -1.0, 1.0])
    mirrored = dataclasses.replace(whole, points=whole.points @ mirror)
    method = remembered((submap("rugged", 1), np.diag([0.02, 0.01])), (submap("mild"), np.diag([5.0, 3.0])))
    R = mirror[:2, :2]
    np.testing.assert_allclose(method.covariance(mirrored), R @ method.covariance(whole) @ R, rtol=0.1, atol=1e-3)


@pytest.mark.parametrize("dof", ["xy", "xyyaw"])
def test_it_turns_with_the_submap(dof):
    M = BOTH[dof].registration.dimensions
    labels = {"rugged": np.diag([0.02, 0.01, 1e-5]), "mild": np.diag([5.0, 3.0, 4e-4])}
    memory = [(submap(kind, 1), q[:M, :M]) for kind, q in labels.items()]
    assert_turns(remembered(*memory, scale=0.5, dof=dof), "rugged", 0.7, 0.2)


def test_far_from_all_that_it_knows_the_nearest_decides():
    method = remembered((submap("flat"), 9 * np.eye(2)), (submap("mild"), np.eye(2)), scale=50.0)
    steep = submap("rugged", height=5.0)
    np.testing.assert_allclose(method.covariance(steep), np.eye(2), atol=1e-6)


def test_its_mean_kl_is_that_of_each_submap_judged_by_the_other_blocks(training, fit):
    method, block = (
        cello.from_fit("cello", fit, SETUP),
        cello.blocks([s.survey for s in training.submaps], 2),
    )
    kl = []
    for i, (whole, label) in enumerate(zip(training.submaps, training.labels, strict=True)):
        others = block != block[i]
        without = dataclasses.replace(method, features=method.features[others], variances=method.variances[others])
        q = gaussian.with_floor(without.covariance(whole), FIT.floor_m2)
        kl.append(float(gaussian.kl_divergence(gaussian.with_floor(label, FIT.floor_m2), q)))
    assert np.mean(kl) == pytest.approx(fit.mean_kl, rel=1e-3)


def test_fitted_scales_are_better_than_the_same_one_for_all_and_than_the_mean(training, fit):
    assert fit.mean_kl < 0.3 * fitting.mean_kl(training.labels, training.labels.mean(axis=0), FIT.floor_m2)
    assert np.ptp(list(fit.numbers.values())) > 0.1


def test_labels_that_have_nothing_to_do_with_the_ground_are_averaged(training):
    rng = np.random.default_rng(3)
    labels = rng.permutation([np.eye(2), 4 * np.eye(2)] * 5)
    fit = cello.fit(dataclasses.replace(training, labels=labels), BLOCKS)
    q = cello.from_fit("cello", fit, SETUP).covariance(submap("mild", 5))
    assert 1.3 < q[0, 0] < 3.7


def test_few_submaps_to_judge_on_leave_the_memory_whole(training):
    fit = cello.fit(training, dataclasses.replace(BLOCKS, judged=4))
    assert len(fit.rows) == len(training.submaps)
    assert np.isfinite(fit.mean_kl)


def test_one_submap_alone_is_judged_by_itself(training):
    alone = fitting.Training(training.submaps[:1], training.labels[:1], SETUP)
    q = cello.from_fit("cello", cello.fit(alone, BLOCKS), SETUP).covariance(training.submaps[0])
    assert np.trace(q) == pytest.approx(np.trace(training.labels[0]), rel=1e-4)


def test_blocks_are_of_consecutive_submaps_of_one_survey():
    block = cello.blocks(["a"] * 5 + ["b"] * 4, 2)
    assert block.tolist() == [0, 0, 0, 1, 1, 2, 2, 3, 3]
    assert len(set(cello.blocks(["a"], 5))) == 1


def test_roughness_is_how_far_points_lie_from_their_plane():
    points = terrains.cloud("flat", 900)
    points[:, 2] += np.random.default_rng(1).normal(0, 0.2, len(points))
    mean = cello.roughness(gicp.prepare(points, REGISTRATION)).mean()
    assert mean == pytest.approx(0.2**2, rel=0.2)
