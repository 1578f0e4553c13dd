"""PointNetKL: what holds for any weights."""

import dataclasses

import numpy as np
import pytest
import torch

from pointnetkl.models import cholesky
from pointnetkl.models import pointnetkl as network
from pointnetkl.models.model import Model, ModelError, predict
from pointnetkl.registration.covariance import gaussian
from pointnetkl.workflow import parameters

SMALL = network.Settings(scale_input=True, hidden_layers=2, hidden_width=32, dropout=0.4)
PAPER = network.Settings(scale_input=True, hidden_layers=4, hidden_width=1000, dropout=0.4)


def clouds(count: int, points: int = 60, seed: int = 0) -> np.ndarray:
    """Return clouds (count, points, 3) in the unit ball."""
    rng = np.random.default_rng(seed)
    drawn = rng.normal(size=(count, points, 3))
    return (drawn / np.linalg.norm(drawn, axis=2).max()).astype(np.float32)


def lived_in(settings: network.Settings = SMALL) -> network.PointNetKL:
    """Return a model in evaluation mode whose batch norms and T-Nets are not those of the first moment."""
    torch.manual_seed(0)
    model = network.PointNetKL(settings)
    with torch.no_grad():
        for name, parameter in model.named_parameters():
            if ".matrix." in name:
                parameter.normal_(0, 0.02)
        for seed in range(5):
            model(torch.from_numpy(clouds(8, seed=seed)), torch.linspace(80, 220, 8))
    return model.eval()


def answer(model: Model, cloud: np.ndarray, radius: float) -> np.ndarray:
    """Return the covariance of one whole cloud."""
    return predict(model, (cloud[None], np.array([radius], np.float32)))[0]


@pytest.fixture(scope="module")
def model() -> network.PointNetKL:
    return lived_in()


def test_the_order_of_points_does_not_matter(model: network.PointNetKL):
    cloud = clouds(1)[0]
    shuffled = np.random.default_rng(1).permutation(cloud)
    np.testing.assert_allclose(answer(model, shuffled, 100), answer(model, cloud, 100), rtol=1e-4)


def test_a_cloud_is_judged_alone_whatever_else_is_in_its_batch(model: network.PointNetKL):
    batch, radius = clouds(5), np.linspace(80, 200, 5, dtype=np.float32)
    with torch.inference_mode():
        together = cholesky.covariance(model(torch.from_numpy(batch), torch.from_numpy(radius)))
    alone = [answer(model, cloud, r) for cloud, r in zip(batch, radius, strict=True)]
    np.testing.assert_allclose(together, alone, rtol=1e-3)


def test_points_that_come_twice_change_nothing(model: network.PointNetKL):
    cloud = clouds(1)[0]
    twice = np.concatenate([cloud, cloud[:20]])
    np.testing.assert_allclose(answer(model, twice, 100), answer(model, cloud, 100), rtol=1e-4)


def test_the_radius_matters_only_to_a_network_that_is_given_it(model: network.PointNetKL):
    cloud = clouds(1)[0]
    assert not np.allclose(answer(model, cloud, 100), answer(model, cloud, 200))
    unscaled = lived_in(dataclasses.replace(SMALL, scale_input=False))
    np.testing.assert_array_equal(answer(unscaled, cloud, 100), answer(unscaled, cloud, 200))


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
    q = answer(lived_in(dataclasses.replace(SMALL, dimensions=3)), clouds(1)[0], 100)
    assert gaussian.check(q, "test").shape == (3, 3)


def test_a_model_in_training_mode_is_not_asked():
    with pytest.raises(ModelError, match=r"call model\.eval"):
        answer(network.PointNetKL(SMALL), clouds(1)[0], 100)


def test_settings_that_make_no_network_are_refused():
    with pytest.raises(ValueError, match=r"^dropout is 1"):
        dataclasses.replace(SMALL, dropout=1.0)
    with pytest.raises(ValueError, match=r"^dimensions is 4"):
        dataclasses.replace(SMALL, dimensions=4)
    assert parameters.as_metadata(SMALL)["hidden_width"] == 32
