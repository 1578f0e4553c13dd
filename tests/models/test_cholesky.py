"""[l, d]: every one is a covariance, and its divergence from a label is that of the matrices, to the last digits."""

import numpy as np
import pytest
import torch

from pointnetkl.models import cholesky
from pointnetkl.registration.covariance import gaussian


def numbers(count: int, m: int, seed: int = 0) -> torch.Tensor:
    """Return random [l, d] (count, M (M + 1) / 2), float64."""
    generator = torch.Generator().manual_seed(seed)
    return torch.randn(count, m * (m + 1) // 2, dtype=torch.float64, generator=generator)


def floor(m: int, floor_m2: float) -> torch.Tensor:
    """Return the floor's diagonal (M,), as methods are judged with it."""
    return torch.from_numpy(np.diag(gaussian.with_floor(np.zeros((m, m)), floor_m2)).copy())


@pytest.mark.parametrize("m", [2, 3])
def test_every_answer_is_symmetric_and_positive_definite(m: int):
    for q in cholesky.covariance(2 * numbers(200, m), m).numpy():
        gaussian.check(q, "test")


@pytest.mark.parametrize("m", [2, 3])
def test_l_and_d_are_the_cholesky_composition_of_the_paper(m: int):
    numbers = torch.arange(1.0, 1 + m * (m + 1) // 2, dtype=torch.float64)[None]
    below, d = numbers[0, :-m].numpy(), numbers[0, -m:].numpy()
    lower = np.eye(m)
    lower[np.tril_indices(m, -1)] = below
    np.testing.assert_allclose(cholesky.covariance(numbers, m)[0], lower @ np.diag(np.exp(d)) @ lower.T)


@pytest.mark.parametrize("m", [2, 3])
@pytest.mark.parametrize("floor_m2", [0.0, 0.01])
def test_divergence_from_l_and_d_is_that_of_the_matrices_with_the_floor_on_both(m: int, floor_m2: float):
    label, answer = cholesky.covariance(numbers(100, m), m), cholesky.covariance(numbers(100, m, seed=1), m)
    expected = gaussian.kl_divergence(*(gaussian.with_floor(q.numpy(), floor_m2) for q in (label, answer)))
    divergence = cholesky.kl_divergence(label, numbers(100, m, seed=1), floor(m, floor_m2))
    np.testing.assert_allclose(divergence, expected, atol=1e-9)


@pytest.mark.parametrize("m", [2, 3])
@pytest.mark.parametrize("floor_m2", [0.0, 0.01])
def test_the_gradient_is_that_of_finite_differences(m: int, floor_m2: float):
    label = cholesky.covariance(numbers(5, m), m)
    answer = numbers(5, m, seed=1).requires_grad_()
    torch.autograd.gradcheck(lambda n: cholesky.kl_divergence(label, n, floor(m, floor_m2)), answer)


def test_float32_is_enough_for_a_covariance_far_flatter_than_the_floor():
    label = torch.tensor([[[1.0, 0.3], [0.3, 2.0]]]).expand(4, 2, 2)
    answer = torch.tensor([[0.5, -30.0, -25.0], [0.0, -60.0, -60.0], [3.0, 2.0, -40.0], [-50.0, 2.0, -3.0]])
    exact = cholesky.kl_divergence(label.double(), answer.double(), floor(2, 0.01))
    numbers_ = answer.clone().requires_grad_()
    divergence = cholesky.kl_divergence(label, numbers_, floor(2, 0.01).float())
    np.testing.assert_allclose(divergence.detach(), exact, rtol=1e-4)
    divergence.sum().backward()
    assert torch.isfinite(numbers_.grad).all()


@pytest.mark.parametrize("m", [2, 3])
def test_divergence_has_its_minimum_of_zero_where_the_answer_is_the_label(m: int):
    answer = numbers(20, m).requires_grad_()
    divergence = cholesky.kl_divergence(cholesky.covariance(answer.detach(), m), answer, floor(m, 0.01))
    divergence.sum().backward()
    np.testing.assert_allclose(divergence.detach(), 0, atol=1e-12)
    np.testing.assert_allclose(answer.grad, 0, atol=1e-12)
