"""PointNetKL: what holds for any weights."""

import dataclasses

import numpy as np
import pytest
import torch

from pointnetkl import network, settings
from pointnetkl.covariance import gaussian

SMALL = network.Settings(scale_input=True, hidden_layers=2, hidden_width=32, dropout=0.4)
PAPER = network.Settings(scale_input=True, hidden_layers=4, hidden_width=1000, dropout=0.4)


def clouds(count: int, points: int = 60, seed: int = 0) -> np.ndarray:
    """Return clouds (count, points, 3) in the unit ball."""
    rng = np.random.default_rng(seed)
    drawn = rng.normal(size=(count, points, 3))
    return (drawn / np.linalg.norm(drawn, axis=2).max()).astype(np.float32)


def lived_in(chosen: network.Settings = SMALL) -> network.PointNetKL:
    """Return a model in evaluation mode whose batch norms and T-Nets are not those of the first moment."""
    torch.manual_seed(0)
    model = network.PointNetKL(chosen)
    with torch.no_grad():
        for name, parameter in model.named_parameters():
            if ".matrix." in name:
                parameter.normal_(0, 0.02)
        for seed in range(5):
            model(torch.from_numpy(clouds(8, seed=seed)), torch.linspace(80, 220, 8))
    return model.eval()


@pytest.fixture(scope="module")
def model() -> network.PointNetKL:
    return lived_in()


@pytest.mark.parametrize("m", [2, 3])
def test_every_answer_is_symmetric_and_positive_definite(m: int):
    numbers = 2 * torch.randn(200, m * (m + 1) // 2, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    for q in network.covariance(numbers, m).numpy():
        gaussian.check(q, "test")


@pytest.mark.parametrize("m", [2, 3])
def test_l_and_d_are_the_cholesky_composition_of_the_paper(m: int):
    numbers = torch.arange(1.0, 1 + m * (m + 1) // 2, dtype=torch.float64)[None]
    below, d = numbers[0, :-m].numpy(), numbers[0, -m:].numpy()
    lower = np.eye(m)
    lower[np.tril_indices(m, -1)] = below
    np.testing.assert_allclose(network.covariance(numbers, m)[0], lower @ np.diag(np.exp(d)) @ lower.T)


@pytest.mark.parametrize("m", [2, 3])
def test_divergence_from_l_and_d_is_that_of_the_matrices(m: int):
    generator = torch.Generator().manual_seed(1)
    numbers = torch.randn(100, m * (m + 1) // 2, dtype=torch.float64, generator=generator)
    factors = torch.linalg.cholesky(network.covariance(numbers.flip(0), m))
    expected = gaussian.kl_divergence((factors @ factors.mT).numpy(), network.covariance(numbers, m).numpy())
    np.testing.assert_allclose(network.kl_divergence(factors, numbers), expected, atol=1e-9)


def test_divergence_of_a_covariance_from_itself_is_zero_however_small_it_is():
    numbers = torch.tensor([[0.5, -30.0, -25.0], [0.0, -60.0, -60.0]])
    factors = torch.linalg.cholesky(network.covariance(numbers.double())).float()
    np.testing.assert_allclose(network.kl_divergence(factors, numbers), 0, atol=1e-4)


def test_divergence_has_its_minimum_where_the_prediction_is_the_label():
    numbers = torch.tensor([[0.3, -1.0, 0.5]], dtype=torch.float64, requires_grad=True)
    factors = torch.linalg.cholesky(network.covariance(numbers.detach()))
    network.kl_divergence(factors, numbers).sum().backward()
    np.testing.assert_allclose(numbers.grad, 0, atol=1e-12)


def test_the_order_of_points_does_not_matter(model: network.PointNetKL):
    cloud = clouds(1)[0]
    shuffled = np.random.default_rng(1).permutation(cloud)
    np.testing.assert_allclose(network.predict(model, shuffled, 100), network.predict(model, cloud, 100), rtol=1e-4)


def test_a_cloud_is_judged_alone_whatever_else_is_in_its_batch(model: network.PointNetKL):
    batch, radius = clouds(5), np.linspace(80, 200, 5, dtype=np.float32)
    with torch.inference_mode():
        together = network.covariance(model(torch.from_numpy(batch), torch.from_numpy(radius)))
    alone = [network.predict(model, cloud, r) for cloud, r in zip(batch, radius, strict=True)]
    np.testing.assert_allclose(together, alone, rtol=1e-3)


def test_points_that_come_twice_change_nothing(model: network.PointNetKL):
    cloud = clouds(1)[0]
    twice = np.concatenate([cloud, cloud[:20]])
    np.testing.assert_allclose(network.predict(model, twice, 100), network.predict(model, cloud, 100), rtol=1e-4)


def test_the_radius_matters_only_to_a_network_that_is_given_it(model: network.PointNetKL):
    cloud = clouds(1)[0]
    assert not np.allclose(network.predict(model, cloud, 100), network.predict(model, cloud, 200))
    unscaled = lived_in(dataclasses.replace(SMALL, scale_input=False))
    np.testing.assert_array_equal(network.predict(unscaled, cloud, 100), network.predict(unscaled, cloud, 200))


def test_transforms_are_the_identity_before_training():
    torch.manual_seed(0)
    points = torch.from_numpy(clouds(4))
    for _ in range(2):
        np.testing.assert_array_equal(network.TransformNet(3)(points).detach(), points)


def test_the_network_has_the_layers_of_the_papers():
    torch.manual_seed(0)
    model = network.PointNetKL(PAPER)
    shapes = [tuple(m.weight.shape) for m in model.modules() if isinstance(m, torch.nn.Linear)]
    transform = [(64, 3), (128, 64), (1024, 128), (512, 1024), (256, 512), (9, 256)]
    features = [(64, 64), (128, 64), (1024, 128), (512, 1024), (256, 512), (4096, 256)]
    shared = [(64, 3), (64, 64)], [(64, 64), (128, 64), (1024, 128)]
    hidden = [(1000, 1025), (1000, 1000), (1000, 1000), (1000, 1000), (3, 1000)]
    assert shapes == [*transform, *shared[0], *features, *shared[1], *hidden]
    kinds = [type(m).__name__ for m in model.psi]
    assert kinds == ["Linear", "BatchNorm1d", "Dropout", "ReLU"] * 4


def test_three_dimensions_give_three_by_three_covariances():
    q = network.predict(lived_in(dataclasses.replace(SMALL, dimensions=3)), clouds(1)[0], 100)
    assert gaussian.check(q, "test").shape == (3, 3)


def test_a_model_in_training_mode_is_not_asked():
    with pytest.raises(network.NetworkError, match=r"call model\.eval"):
        network.predict(network.PointNetKL(SMALL), clouds(1)[0], 100)


def test_settings_that_make_no_network_are_refused():
    with pytest.raises(ValueError, match=r"^dropout is 1"):
        dataclasses.replace(SMALL, dropout=1.0)
    with pytest.raises(ValueError, match=r"^dimensions is 4"):
        dataclasses.replace(SMALL, dimensions=4)
    assert settings.as_metadata(SMALL)["hidden_width"] == 32
