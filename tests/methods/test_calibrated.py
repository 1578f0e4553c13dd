"""Truths of closed forms combined with the prior: saturation on flat ground, and the fit of the two numbers."""

import dataclasses

import numpy as np
import pytest

from pointnetkl.methods import sampled
from pointnetkl.methods.closed_forms import hessian
from pointnetkl.methods.fitted import calibrated, fitting
from toy_submaps import BOTH, FIT, LABEL, REGISTRATION, SETUP, assert_turns, submap

LEARNERS = {"hessian": calibrated.HESSIAN, "censi": calibrated.CENSI}
PRIORS = {2: np.diag([9.0, 9.0]), 3: np.diag([9.0, 9.0, 9e-4])}


def forms(dimensions: int, n: int = 200) -> np.ndarray:
    """Return covariances (n, M, M) from a hundred times the prior to a millionth of it, along all axes."""
    rng = np.random.default_rng(1)
    v = np.linalg.qr(rng.normal(size=(n, dimensions, dimensions)))[0]
    root = np.sqrt(PRIORS[dimensions])
    return root @ (v * 10 ** rng.uniform(-6, 2, (n, 1, dimensions))) @ np.swapaxes(v, 1, 2) @ root


@pytest.fixture(scope="module")
def training() -> fitting.Training:
    """Return submaps from flat to rugged with Monte Carlo labels."""
    submaps = [submap(kind, number) for kind in ("flat", "gentle", "mild", "rugged", "ridge") for number in range(3)]
    label = sampled.Sampled("label", 200, 2, LABEL, REGISTRATION)
    return fitting.Training(submaps, np.stack([label.covariance(s) for s in submaps]), SETUP)


@pytest.mark.parametrize("dimensions", [2, 3])
def test_no_information_leaves_the_prior_and_much_leaves_nothing(dimensions):
    prior = PRIORS[dimensions]
    for share, kept in ((1e9, 1.0), (1e-9, 0.0)):
        q = calibrated.combine(share * prior[None], prior, 3.0, 2.0)[0]
        np.testing.assert_allclose(q, kept * prior, atol=1e-6)


@pytest.mark.parametrize("dimensions", [2, 3])
def test_half_the_prior_is_left_where_the_information_is_the_ratio_times_the_prior_s(dimensions):
    prior = PRIORS[dimensions]
    np.testing.assert_allclose(calibrated.combine(prior[None] / 20, prior, np.log(20), 3.0)[0], prior / 2)


def test_with_gamma_1_it_is_the_product_of_two_gaussians():
    raw, prior = forms(2), PRIORS[2]
    expected = np.linalg.inv(np.linalg.inv(5 * raw) + np.linalg.inv(prior))
    np.testing.assert_allclose(calibrated.combine(raw, prior, np.log(5), 1.0), expected, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("dimensions", [2, 3])
def test_the_fit_recovers_the_numbers_that_made_the_labels(dimensions):
    raw, prior = forms(dimensions), PRIORS[dimensions]
    labels = calibrated.combine(raw, prior, np.log(17), 2.2)
    fit = calibrated.fit_forms(raw, prior, labels, FIT)
    assert fit.mean_kl < 1e-4
    assert fit.numbers["ratio"] == pytest.approx(17, rel=0.05)
    assert fit.numbers["gamma"] == pytest.approx(2.2, rel=0.05)


@pytest.mark.parametrize("form", LEARNERS)
def test_fitted_to_labels_flat_ground_gets_the_prior_and_labels_are_met_better_than_by_their_mean(form, training):
    fit = LEARNERS[form].fit(training, FIT)
    method = LEARNERS[form].from_fit(form, fit, SETUP)
    flat = method.covariance(submap("flat", 7))
    assert np.linalg.eigvalsh(flat)[0] > 0.9 * 9
    assert np.linalg.eigvalsh(flat)[-1] < 9
    assert fit.mean_kl < 0.4 * fitting.mean_kl(training.labels, training.labels.mean(axis=0), FIT.floor_m2)


def test_fitted_numbers_beat_the_closed_form_itself(training):
    raw = np.stack([hessian.Hessian(SETUP).covariance(s) for s in training.submaps])
    assert calibrated.HESSIAN.fit(training, FIT).mean_kl < 0.1 * fitting.mean_kl(training.labels, raw, FIT.floor_m2)


@pytest.mark.parametrize("form", LEARNERS)
@pytest.mark.parametrize("dof", ["xy", "xyyaw"])
@pytest.mark.parametrize("kind", ["mild", "flat"])
def test_it_turns_with_the_submap(form, dof, kind):
    fit = fitting.Fit({"ratio": 17.0, "gamma": 2.0}, 0.0)
    assert_turns(LEARNERS[form].from_fit(form, fit, BOTH[dof]), kind, 0.7, 0.3)


def test_more_noise_on_the_copy_leaves_more_of_the_prior():
    fit = fitting.Fit({"ratio": 17.0, "gamma": 2.0}, 0.0)
    noisy = dataclasses.replace(SETUP, label=dataclasses.replace(LABEL, noise_sigma_m=0.4))
    q = [calibrated.CENSI.from_fit("censi", fit, setup).covariance(submap("mild")) for setup in (SETUP, noisy)]
    assert np.trace(q[1]) > 2 * np.trace(q[0])
