"""Truths of `network`: the mean field's covariance before training, and put right by no more than it may be after."""

import dataclasses
import functools
from pathlib import Path

import numpy as np
import onnxruntime
import pytest
import torch

import terrains
import toy_submaps
from pointnetkl.models import cholesky, mean_field, mean_field_network, model_file
from pointnetkl.models.mean_field_network import AXIS, WHOLE, MeanFieldNetwork, MeanFieldNetworkError
from pointnetkl.models.model import predict
from pointnetkl.models.samples import Samples
from pointnetkl.registration.covariance import gaussian
from pointnetkl.training import loss

LABEL = dataclasses.replace(toy_submaps.LABEL, noise_sigma_m=0.2)
GIVEN = mean_field.conditions(LABEL, toy_submaps.REGISTRATION)
SMALL = mean_field_network.Settings(members=3, hidden_width=8, most=0.7, jitter=0.1, conditions=GIVEN)
BOTH = pytest.mark.parametrize("dimensions", [2, 3])


def model(dimensions: int = 2, wild: float = 0.0) -> MeanFieldNetwork:
    """Return a model in evaluation mode, its weights `wild` times random numbers away from the first moment's."""
    torch.manual_seed(0)
    network = MeanFieldNetwork(dataclasses.replace(SMALL, dimensions=dimensions))
    with torch.no_grad():
        for parameter in network.parameters():
            parameter.add_(wild * torch.randn_like(parameter))
    return network.eval()


def seabed(number: int) -> np.ndarray:
    """Return one of many submaps: gentle to rough, twice as steep one way as the other, at many headings."""
    ground = terrains.cloud("mild", 400, number, size_m=70.0) * [1, 1, 0.05 * 1.5 ** (number % 8)]
    return ground @ toy_submaps.rotation(0.7 * number, 3).T


@functools.cache
def samples(dimensions: int, count: int = 24) -> Samples:
    """Return submaps whose labels are three times what the mean field says."""
    described = np.stack([model(dimensions).describe(seabed(number)) for number in range(count)])
    labels = 3 * predict(model(dimensions), (described,))
    return Samples(
        np.full(count, "toy"), np.arange(count), [np.zeros((1, 3))] * count, np.ones(count), labels, described
    )


@BOTH
def test_before_training_it_answers_with_the_mean_fields_covariance(dimensions: int):
    untrained, learned = model(dimensions), samples(dimensions)
    untrained.start(learned)
    for number in range(8):
        described = mean_field.describe(seabed(number), GIVEN)
        q = predict(untrained, (learned.described[number : number + 1],))[0]
        np.testing.assert_allclose(q[:2, :2], described.covariance, rtol=1e-4, atol=1e-4 * np.trace(q[:2, :2]))
        if dimensions == 3:
            assert q[2, 2] == pytest.approx(described.yaw_variance(GIVEN), rel=1e-4)
            np.testing.assert_array_equal(q[2, :2], 0)


@BOTH
@pytest.mark.parametrize("wild", [0.3, 100.0])
def test_no_variance_is_corrected_by_more_than_the_most(dimensions: int, wild: float):
    inputs = (samples(dimensions).described,)
    before, after = predict(model(dimensions), inputs), predict(model(dimensions, wild), inputs)
    roots = np.linalg.inv(np.linalg.cholesky(before))
    ratios = np.linalg.eigvalsh(roots @ after @ roots.mT)
    assert np.abs(np.log(ratios)).max() < SMALL.most * 1.001 + 1e-3
    assert np.abs(np.log(ratios)).max() > 0.1 * SMALL.most


@BOTH
def test_its_numbers_give_back_the_turned_diagonal(dimensions: int):
    for angle in np.linspace(-np.pi, np.pi, 13):
        logs = torch.tensor([[-9.0, 2.0, -12.0]], dtype=torch.float64)[:, :dimensions]
        cosine, sine = torch.tensor([[np.cos(angle)], [np.sin(angle)]])
        numbers = mean_field_network._numbers(logs, cosine, sine)
        R = toy_submaps.rotation(angle, dimensions)
        expected = R @ np.diag(logs[0].exp().numpy()) @ R.T
        np.testing.assert_allclose(cholesky.covariance(numbers, dimensions)[0], expected, rtol=1e-9, atol=1e-9)


@BOTH
def test_a_turned_submap_has_a_turned_covariance(dimensions: int):
    wild, points = model(dimensions, 0.3), terrains.cloud("mild", 900)
    R = toy_submaps.rotation(0.8, 3)
    q, turned = (predict(wild, (wild.describe(each)[None],))[0] for each in (points, points @ R.T))
    R = R[:dimensions, :dimensions]
    assert gaussian.kl_divergence(gaussian.with_floor(R @ q @ R.T, 0.01), gaussian.with_floor(turned, 0.01)) < 0.02


@BOTH
def test_the_heading_turns_the_answer_and_does_nothing_else(dimensions: int):
    described, wild = samples(dimensions).described, model(dimensions, 0.3)
    R = toy_submaps.rotation(0.8, dimensions)
    turned = described.copy()
    turned[:, dimensions : dimensions + 2] @= R[:2, :2].T
    np.testing.assert_allclose(predict(wild, (turned,)), R @ predict(wild, (described,)) @ R.T, rtol=1e-3, atol=1e-6)


def test_a_submap_is_judged_alone_whatever_else_is_in_its_batch():
    described, wild = samples(2).described, model(2, 0.3)
    alone = [predict(wild, (described[i : i + 1],))[0] for i in range(len(described))]
    np.testing.assert_allclose(predict(wild, (described,)), alone, rtol=1e-4, atol=1e-9)


def test_a_submap_unlike_all_others_is_corrected_as_one_at_their_edge():
    trained = model(2, 0.3)
    trained.start(samples(2))
    far, farther = (samples(2).described[:1].copy() for _ in range(2))
    far[:, 4:] += 1e3
    farther[:, 4:] += 1e6
    np.testing.assert_array_equal(predict(trained, (far,)), predict(trained, (farther,)))


@BOTH
def test_training_learns_what_the_mean_field_does_not_say(dimensions: int):
    learned, untrained = samples(dimensions), model(dimensions)
    untrained.start(learned)
    torch.manual_seed(1)
    optimiser = torch.optim.Adam(untrained.train().parameters(), 3e-2)
    rng = np.random.default_rng(0)
    seen = []
    for _ in range(25):
        mean = loss.divergences(untrained, learned, np.arange(len(learned)), 1, 0.0, rng).mean()
        optimiser.zero_grad()
        mean.backward()
        optimiser.step()
        seen.append(mean.item())
    # three times the variance is a log of 1.1, of which it may correct 0.7
    limit = dimensions * 0.5 * (np.exp(np.log(3) - SMALL.most) - 1 - (np.log(3) - SMALL.most))
    assert limit < seen[-1] < seen[0] - 0.6 * (seen[0] - limit)


@BOTH
def test_its_file_brings_it_back(dimensions: int, tmp_path: Path):
    written = model(dimensions, 0.3)
    written.start(samples(dimensions))
    path = tmp_path / "network.pt"
    path.write_bytes(model_file.to_bytes("mean_field", written, 0.01, {}))
    stored = model_file.read(path)
    assert stored.kind == "mean_field"
    assert stored.model.settings == written.settings
    described = stored.model.describe(seabed(1))[None]
    np.testing.assert_array_equal(described[0], written.describe(seabed(1)))
    np.testing.assert_array_equal(predict(stored.model, (described,)), predict(written, (described,)))


@BOTH
def test_onnx_gives_the_same_covariances_for_any_number_of_submaps(dimensions: int):
    wild, described = model(dimensions, 0.3), samples(dimensions).described
    content = model_file.to_onnx(wild)
    session = onnxruntime.InferenceSession(content, providers=["CPUExecutionProvider"])
    for count in (1, 2, 7):
        (exported,) = session.run(None, {"description": described[:count]})
        np.testing.assert_allclose(exported, predict(wild, (described[:count],)), rtol=1e-4, atol=1e-7)


@BOTH
def test_its_example_is_of_the_size_of_a_description(dimensions: int):
    (example,) = model(dimensions).example().values()
    assert example.value.shape[1] == samples(dimensions).described.shape[1]
    assert example.value.shape[1] == dimensions + 2 + dimensions * AXIS + WHOLE


def test_without_conditions_or_descriptions_it_says_what_to_do():
    with pytest.raises(MeanFieldNetworkError, match="train it again"):
        MeanFieldNetwork(dataclasses.replace(SMALL, conditions=None)).describe(seabed(0))
    with pytest.raises(MeanFieldNetworkError, match="`describe`"):
        model().start(dataclasses.replace(samples(2), described=None))


@pytest.mark.parametrize(
    ("name", "value"), [("members", 0), ("hidden_width", 0), ("most", 0.0), ("jitter", -0.1), ("dimensions", 4)]
)
def test_settings_refuse_what_makes_no_network(name: str, value: float):
    with pytest.raises(ValueError, match=f"^{name} is {value}"):
        dataclasses.replace(SMALL, **{name: value})
