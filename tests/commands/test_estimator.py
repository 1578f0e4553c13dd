"""A trained model on board: raw points in, a covariance out, whatever the frame; and ONNX says the same."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import onnxruntime
import pytest
import torch

import pointnetkl
import terrains
import toy_models
from pointnetkl.models import model_file
from pointnetkl.registration.covariance import gaussian
from pointnetkl.surveys import voxel

FAR = np.array([5e5, 6.4e6, -3000.0])  # in coordinates of a map projection


@pytest.fixture(scope="module")
def estimators(tmp_path_factory: pytest.TempPathFactory) -> dict[str, pointnetkl.CovarianceEstimator]:
    folder = tmp_path_factory.mktemp("models")
    return {kind: pointnetkl.CovarianceEstimator.load(toy_models.write(folder, kind)) for kind in toy_models.KINDS}


def test_importing_the_package_imports_none_of_its_libraries():
    script = "import sys, pointnetkl; print([m for m in ('numpy', 'torch', 'numba', 'open3d') if m in sys.modules])"
    result = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert result.stdout.strip() == "[]", result.stderr
    with pytest.raises(AttributeError, match="no attribute 'Covariance'"):
        _ = pointnetkl.Covariance


@pytest.mark.parametrize("kind", toy_models.KINDS)
def test_a_model_with_matrices_in_half_precision_answers_alike(tmp_path: Path, kind: str):
    path = toy_models.write(tmp_path, kind)
    (tmp_path / "half.pt").write_bytes(model_file.halved(model_file.read(path)))
    whole, half = (pointnetkl.CovarianceEstimator.load(file) for file in (path, tmp_path / "half.pt"))
    points = terrains.cloud("mild", 900)
    np.testing.assert_allclose(half.predict(points), whole.predict(points), rtol=0.02)
    assert not np.array_equal(half.predict(points), whole.predict(points))


def test_a_model_that_comes_with_the_package_is_found_by_its_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(model_file, "shipped", lambda: {"mine": toy_models.write(tmp_path, "pointnetkl")})
    by_name, by_path = (pointnetkl.CovarianceEstimator.load(m) for m in ("mine", tmp_path / "pointnetkl.pt"))
    points = terrains.cloud("mild", 900)
    np.testing.assert_array_equal(by_name.predict(points), by_path.predict(points))


def test_a_weight_beyond_half_precision_is_refused(tmp_path: Path):
    stored = model_file.read(toy_models.write(tmp_path, "pointnetkl"))
    with torch.no_grad():
        stored.model.last.weight[0, 0] = 1e5
    with pytest.raises(model_file.ModelFileError, match=r"last\.weight: has a weight beyond 65504"):
        model_file.halved(stored)


@pytest.mark.parametrize("kind", toy_models.KINDS)
@pytest.mark.parametrize("dimensions", [2, 3])
def test_raw_points_give_a_covariance_of_the_model_s_dimensions(tmp_path: Path, kind: str, dimensions: int):
    estimator = pointnetkl.CovarianceEstimator.load(str(toy_models.write(tmp_path, kind, dimensions)))
    q = estimator.predict(terrains.cloud("mild", 900))
    assert gaussian.check(q, kind).shape == (dimensions, dimensions)


@pytest.mark.parametrize("kind", toy_models.KINDS)
def test_the_origin_of_the_frame_does_not_matter(estimators: dict, kind: str):
    points = terrains.cloud("mild", 900)
    moved = estimators[kind].predict(points + FAR)
    assert gaussian.kl_divergence(moved, estimators[kind].predict(points)) < 1e-3


def test_a_turned_submap_has_a_turned_covariance(estimators: dict):
    R = np.array([[0.6, -0.8, 0], [0.8, 0.6, 0], [0, 0, 1]])
    points = terrains.cloud("ridge", 1600)
    q, turned = (estimators["mean_field"].judge(p).covariance for p in (points, points @ R.T))
    expected = R[:2, :2] @ q @ R[:2, :2].T
    assert gaussian.kl_divergence(turned, expected) < 0.2
    assert gaussian.kl_divergence(turned, q) > 1


@pytest.mark.parametrize("kind", toy_models.KINDS)
def test_a_submap_unlike_the_training_ones_is_flagged(estimators: dict, kind: str):
    usual = estimators[kind].judge(terrains.cloud("mild", 900, 60))
    assert not usual.is_novel
    foreign = estimators[kind].judge(terrains.cloud("mild", 900, 60) * [4, 4, 1])
    assert foreign.is_novel
    assert foreign.novelty > 1 > usual.novelty


def test_a_model_without_its_training_submaps_flags_nothing(tmp_path: Path):
    (tmp_path / "old.pt").write_bytes(model_file.to_bytes("pointnetkl", toy_models.model("pointnetkl"), 0.01, {}))
    judged = pointnetkl.CovarianceEstimator.load(tmp_path / "old.pt").judge(terrains.cloud("mild", 100) * 50)
    assert (judged.novelty, judged.is_novel) == (None, False)


def spoiled(**change: float) -> np.ndarray:
    points = terrains.cloud("mild", 100)
    for axis, value in change.items():
        points[7, "xyz".index(axis)] = value
    return points


@pytest.mark.parametrize("kind", toy_models.KINDS)
@pytest.mark.parametrize(
    ("points", "sentence"),
    [
        (np.zeros((10, 2)), r"float64 of shape \(10, 2\)"),
        (np.array([["a", "b", "c"]] * 30), r"<U1 of shape \(30, 3\), must be"),
        (np.zeros((0, 3)), "a submap of 0 points cannot be registered, 20"),
        (terrains.cloud("mild", 9), "a submap of 9 points"),
        (spoiled(z=np.nan), "1 of 100 points have a coordinate that is no number"),
        (spoiled(x=np.inf), "1 of 100 points"),
        (np.ones((30, 3)), "on a line or in one place"),
        (np.outer(np.arange(30), [1.0, 2.0, 0.1]), "on a line"),
        (spoiled(x=1e5), "a point lies 99000 m from the middle"),
        ((terrains.cloud("mild", 100) + FAR).astype(np.float32), "float32, whole steps of 0.5 m"),
    ],
)
def test_what_is_no_submap_is_refused_in_a_sentence(estimators: dict, kind: str, points: np.ndarray, sentence: str):
    with pytest.raises(pointnetkl.estimator.EstimatorError, match=sentence) as refused:
        estimators[kind].predict(points)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("dimensions", [2, 3])
@pytest.mark.parametrize("kind", toy_models.KINDS)
def test_onnx_gives_the_same_covariance(tmp_path: Path, kind: str, dimensions: int):
    model = toy_models.model(kind, dimensions)
    session = onnxruntime.InferenceSession(model_file.to_onnx(model), providers=["CPUExecutionProvider"])
    estimator = pointnetkl.CovarianceEstimator.load(toy_models.write(tmp_path, kind, dimensions))
    for terrain in ("flat", "ridge", "rugged"):
        points = terrains.cloud(terrain, 900)
        if model.describe:
            inputs = {"description": model.describe(points - points.mean(axis=0))[None]}
        else:
            cloud = voxel.canonical(points, 0.01)
            inputs = {"points": cloud.points[None], "radius": np.array([cloud.radius], np.float32)}
        (q,) = session.run(["covariance"], inputs)
        np.testing.assert_allclose(q[0], estimator.predict(points), rtol=1e-3, atol=1e-7)
