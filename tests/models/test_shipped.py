"""The models that come with the package: they load by name, answer, and are those of the paper's training surveys."""

from pathlib import Path

import numpy as np
import pytest

import terrains
from pointnetkl import CovarianceEstimator
from pointnetkl.models import model_file

_MOST_BYTES = 20_000_000  # of one file in git
_SURVEYS = ["baltic", "shetland", "borno_1", "antarctica_7"]


def submap() -> np.ndarray:
    """Return the points (2500, 3) of a square of hills, metres."""
    x, y = (axis.ravel() for axis in np.meshgrid(np.arange(50) * 3.2, np.arange(50) * 3.2))
    return np.column_stack([x, y, 4 * terrains.height("mild", np.column_stack([x, y]) / 4)])


def test_the_paper_s_network_and_ours_are_there():
    assert set(model_file.shipped()) == {"network", "pointnetkl"}


@pytest.mark.parametrize(
    ("name", "expected"),  # as the trained weights say before they are halved, within 1 %
    [("network", [[1.339e-3, -3.285e-4], [-3.285e-4, 1.339e-3]]), ("pointnetkl", [[1.483, 1e-4], [1e-4, 0.0633]])],
)
def test_a_shipped_model_answers_by_its_name(name: str, expected: list[list[float]]):
    Q = CovarianceEstimator.load(name).predict(submap())
    assert np.diag(Q) == pytest.approx(np.diag(expected), rel=0.02)
    assert pytest.approx(expected[0][1], abs=0.02 * np.trace(expected)) == Q[0, 1]


def test_the_shipped_network_tells_hills_from_a_ridge_and_from_flat_ground():
    network, hills = CovarianceEstimator.load("network"), submap()
    ridge = np.column_stack([hills[:, :2], 4 * np.exp(-(((hills[:, 1] - 78) / 15) ** 2))])
    flat = hills * [1.0, 1.0, 0.0]
    along, across = np.diag(network.predict(ridge))
    assert across < 0.01 < 1.0 < along
    assert np.diag(network.predict(flat)).min() > 1.0
    assert np.diag(network.predict(hills)).max() < 0.01


@pytest.mark.parametrize("name", ["network", "pointnetkl"])
def test_a_shipped_model_says_what_it_was_trained_on(name: str):
    path: Path = model_file.shipped()[name]
    stored = model_file.read(path)
    assert stored.metadata["surveys"] == _SURVEYS
    assert stored.metadata["label"]["copy"] == "same"
    assert path.stat().st_size < _MOST_BYTES
