"""What is like the training submaps and what is not."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import terrains
import toy_models
from pointnetkl.models import novelty
from pointnetkl.surveys import submap as submaps
from pointnetkl.training import dataset
from pointnetkl.workflow import artifacts

ROOT = Path(__file__).parents[2]
HEIGHTS = np.linspace(0.2, 2.0, 12)


def submap(height: float, number: int, points: int = 900) -> np.ndarray:
    return terrains.cloud("mild", points, number) * [1, 1, height]


@pytest.fixture(scope="module")
def traits() -> novelty.TraitDistribution:
    """Two surveys of submaps from smooth to rough."""
    seen = [submap(height, 12 * s + i) for s in range(2) for i, height in enumerate(HEIGHTS)]
    return novelty.learn(np.stack([novelty.traits(p) for p in seen]), np.repeat(["a", "b"], 12))


def test_a_submap_s_traits_do_not_depend_on_its_frame():
    points = submap(1.0, 0)
    c, s = np.cos(0.7), np.sin(0.7)
    moved = points @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]).T + [5e5, 6.4e6, -900.0]
    # a point on the border between two cells may fall to either
    np.testing.assert_allclose(novelty.traits(moved), novelty.traits(points), atol=0.03)
    shuffled = np.random.default_rng(0).permutation(points)
    np.testing.assert_allclose(novelty.traits(shuffled), novelty.traits(points), atol=1e-9)


def test_new_ground_of_the_same_kind_is_known(traits: novelty.TraitDistribution):
    assert max(traits.novelty(submap(height, 50 + i)) for i, height in enumerate(HEIGHTS)) < 1.2
    assert traits.novelty(submap(1.0, 60)) < 1


def spiky(points: np.ndarray) -> np.ndarray:
    rng = np.random.default_rng(0)
    return points + np.outer(rng.random(len(points)) < 0.01, [0, 0, 20.0])


@pytest.mark.parametrize(
    "change",
    [
        lambda p: p[::9],
        lambda p: p * [4, 4, 1],
        lambda p: p * [1, 1, 20],
        lambda p: p[np.abs(p[:, 0]) < 3],
        lambda p: p[p[:, 0] > 0],
        spiky,
    ],
    ids=["thinned", "large", "steep", "a line of the swath", "half", "spikes"],
)
def test_other_submaps_are_new(traits: novelty.TraitDistribution, change):
    assert traits.novelty(change(submap(1.0, 70))) > 1


def test_the_limit_is_that_of_surveys_left_out():
    rng = np.random.default_rng(1)
    alike = rng.normal(size=(3000, 8))
    assert novelty.learn(alike, np.repeat(["a", "b", "c"], 1000)).limit == pytest.approx(1.6, abs=0.1)  # chi of 8
    apart = alike + np.repeat([-4.0, 0.0, 4.0], 1000)[:, None]
    learned = novelty.learn(apart, np.repeat(["a", "b", "c"], 1000))
    assert learned.limit > 1.75
    assert learned.distance(apart).mean() < 1.1


def test_a_single_survey_is_judged_by_its_halves():
    seen = np.random.default_rng(2).normal(size=(400, 8)) + np.repeat([0.0, 3.0], 200)[:, None]
    alone = novelty.learn(seen, np.repeat("a", 400)).limit
    assert alone == pytest.approx(novelty.learn(seen, np.repeat(["a", "b"], 200)).limit)


def test_what_is_the_same_in_all_training_submaps_may_differ_a_little():
    same = novelty.learn(np.zeros((20, 8)), np.repeat(["a", "b"], 10))
    assert same.distance(np.full(8, 0.1)) == pytest.approx(1.0)


@pytest.mark.slow
def test_the_benchmark_counts_what_is_flagged(tmp_path: Path):
    drawn = [submaps.Submap("mine", i, *3 * [submap(1.0, 50 + i)]) for i in range(8)]
    labels = pd.DataFrame({"submap": range(8), "q_xx_m2": 1.0, "q_xy_m2": 0.0, "q_yy_m2": 1.0})
    artifacts.write_table(tmp_path / "test/mine/submaps.parquet", submaps.to_table(drawn), submaps.POINTS, {})
    artifacts.write_table(tmp_path / "test/mine/labels.parquet", labels, dataset.LABEL, {})
    words = ["benchmarks/novelty.py", "mine", "--data", tmp_path, "--model", toy_models.write(tmp_path, "pointnetkl")]
    result = subprocess.run([sys.executable, *map(str, words)], cwd=ROOT, capture_output=True, text=True)
    assert result.returncode == 0, result.stderr
    surveys, changes = result.stdout.strip().split("\n\n")
    name, count, share = surveys.splitlines()[1].split(",")[:3]
    assert (name, count) == ("mine", "8")
    assert float(share) < 0.5
    assert "half of it,1.0" in changes.splitlines()
