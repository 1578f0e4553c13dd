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


@pytest.mark.parametrize("name", ["network", "pointnetkl"])
def test_a_shipped_model_answers_by_its_name(name: str):
    Q = CovarianceEstimator.load(name).predict(submap())
    assert Q.shape == (2, 2)
    assert (np.linalg.eigvalsh(Q) > 0).all()
    assert np.sqrt(np.diag(Q)).max() < 5.0  # metres: the spread of the starts is 3


@pytest.mark.parametrize("name", ["network", "pointnetkl"])
def test_a_shipped_model_says_what_it_was_trained_on(name: str):
    path: Path = model_file.shipped()[name]
    stored = model_file.read(path)
    assert stored.metadata["surveys"] == _SURVEYS
    assert stored.metadata["label"]["copy"] == "same"
    assert path.stat().st_size < _MOST_BYTES
