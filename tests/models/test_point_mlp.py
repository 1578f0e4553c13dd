"""The fast layers of a PointNet against torch's, one after the other."""

import copy
from collections.abc import Callable

import numba
import numpy as np
import pytest
import torch
from torch import Tensor

from pointnetkl.models import point_mlp
from pointnetkl.models.model import ModelError
from pointnetkl.models.point_mlp import PointMLP, PooledMLP


def layer_by_layer(layers: PointMLP, features: Tensor) -> Tensor:
    """Return what the MLP stands for, computed as the paper draws it."""
    rows = torch.nn.Sequential.forward(layers, features.reshape(-1, features.shape[-1]))
    outputs = rows.reshape(*features.shape[:-1], -1)
    return outputs.amax(dim=1) if isinstance(layers, PooledMLP) else outputs


def some(kind: type[PointMLP], dtype: torch.dtype) -> PointMLP:
    """Return an MLP whose norms are those of one that has been trained for a while, some of their weights negative."""
    torch.manual_seed(0)
    layers = kind((5, 16, 40))
    with torch.no_grad():
        for norm in (layers[1], layers[4]):
            norm.weight.normal_()
            norm.bias.normal_()
            norm.running_mean.normal_()
    return layers.to(dtype)


def outcome(layers: PointMLP, compute: Callable[[Tensor], Tensor], features: Tensor) -> dict[str, Tensor]:
    """Return the answer, every gradient and every statistic; a bias before a norm is without effect, and none is 0."""
    leaf = features.clone().requires_grad_()
    answer = compute(leaf)
    answer.sin().sum().backward()
    gradients = {k: torch.zeros_like(p) if p.grad is None else p.grad for k, p in layers.named_parameters()}
    return {"answer": answer.detach(), "features": leaf.grad, **gradients, **dict(layers.named_buffers())}


@pytest.mark.parametrize("kind", [PointMLP, PooledMLP])
@pytest.mark.parametrize("training", [True, False])
@pytest.mark.parametrize(("dtype", "tolerance"), [(torch.float64, 1e-9), (torch.float32, 2e-4)])
def test_answers_gradients_and_statistics_are_those_of_one_layer_after_the_other(
    kind: type[PointMLP], training: bool, dtype: torch.dtype, tolerance: float
):
    fast = some(kind, dtype).train(training)
    slow = copy.deepcopy(fast)
    torch.manual_seed(1)
    features = torch.randn(6, 30, 5, dtype=dtype) if kind is PooledMLP else torch.randn(180, 5, dtype=dtype)
    expected = outcome(slow, lambda leaf: layer_by_layer(slow, leaf), features)
    found = outcome(fast, fast, features)
    assert found.keys() == expected.keys()
    for name, value in expected.items():
        np.testing.assert_allclose(found[name], value, rtol=tolerance, atol=tolerance, err_msg=name)


@pytest.mark.skipif(numba.get_num_threads() < 2, reason="one core has one number of threads")
def test_the_number_of_the_kernels_threads_changes_no_bit():
    features = torch.randn(40, 100, 5)  # searched in two parts
    before = numba.get_num_threads()
    outcomes = []
    for threads in (1, before):
        numba.set_num_threads(threads)
        layers = some(PooledMLP, torch.float32).train()
        outcomes.append(outcome(layers, layers, features))
    for name, value in outcomes[0].items():
        np.testing.assert_array_equal(outcomes[1][name], value, err_msg=name)


@pytest.mark.parametrize("kind", [PointMLP, PooledMLP])
def test_a_coordinate_that_is_no_number_is_not_lost(kind: type[PointMLP]):
    layers = some(kind, torch.float32).train()
    features = torch.randn(6, 30, 5) if kind is PooledMLP else torch.randn(180, 5)
    features.view(-1)[3] = float("nan")
    assert layers(features).isnan().any()


def test_one_row_in_training_is_refused_and_changes_no_statistic():
    layers = some(PooledMLP, torch.float32).train()
    before = layers[1].running_mean.clone()
    with pytest.raises(ModelError, match="has 1 row to take a variance of"):
        layers(torch.randn(1, 1, 5))
    np.testing.assert_array_equal(layers[1].running_mean, before)


def test_autocast_on_a_cpu_takes_torch_s_operations():
    layers = some(PooledMLP, torch.float32).train()
    with torch.autocast("cpu", torch.bfloat16):
        layers(torch.randn(6, 30, 5)).sum().backward()
    assert all(parameter.grad.isfinite().all() for parameter in layers.parameters() if parameter.grad is not None)


def test_a_search_that_may_round_ends_near_the_largest():
    features = torch.randn(6, 30, 5)
    layers = some(PooledMLP, torch.float32).train()
    exact = layers(features)
    point_mlp.search_in(layers, "bfloat16")
    np.testing.assert_allclose(layers(features).detach(), exact.detach(), atol=0.05)


def test_a_channel_far_from_zero_keeps_its_variance():
    layers = PointMLP((1, 1))
    with torch.no_grad():
        layers[0].weight.fill_(1)
        layers[0].bias.fill_(3000)
    rows = torch.randn(5000, 1)
    layers(rows)
    np.testing.assert_allclose(layers[1].running_var, 0.9 + 0.1 * rows.var(), rtol=1e-3)
