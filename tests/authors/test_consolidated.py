"""The authors' arrays: every row is checked, with its units and frames."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import authors_arrays
from pointnetkl.authors import consolidated
from pointnetkl.registration.covariance import gaussian
from pointnetkl.surveys import voxel
from pointnetkl.workflow.errors import PointNetKLError


def changed(**cells: Any) -> list[tuple[Any, ...]]:
    """Return rows of which the second has other cells."""
    names = ("points", "prior", "posterior", "rho", "submap", "covariance")
    rows_by_file = authors_arrays.rows(3)
    rows_by_file[1] = tuple(cells.get(name, cell) for name, cell in zip(names, rows_by_file[1], strict=True))
    return rows_by_file


def refusal(folder: Path, rows_by_file: list[tuple[Any, ...]]) -> str:
    path = authors_arrays.write(folder / "baltic.npy", rows_by_file)
    with pytest.raises(PointNetKLError) as caught:
        consolidated.read(path)
    assert "\n" not in str(caught.value)
    return str(caught.value).removeprefix(str(path))


def test_rows_become_clouds_labels_and_priors_in_the_order_of_the_file(tmp_path: Path):
    rows = authors_arrays.rows(5)
    read = consolidated.read(authors_arrays.write(tmp_path / "baltic.npy", rows))
    assert len(read) == 5
    assert read.clouds.submap.tolist() == [0, 1, 2, 3, 4]
    for i, (points, prior, posterior, rho, *files) in enumerate(rows):
        cloud = read.clouds.cloud(i)
        np.testing.assert_allclose(cloud.points, points, atol=1e-7)
        assert (cloud.points.dtype, cloud.radius) == (np.float32, rho)
        np.testing.assert_array_equal(read.prior[i], prior)
        np.testing.assert_allclose(read.label[i], posterior, rtol=1e-12)
        assert read.files[i] == tuple(files)


def test_sigma_z_is_pooled_over_the_points_of_all_rows(tmp_path: Path):
    rows = authors_arrays.rows(6)
    read = consolidated.read(authors_arrays.write(tmp_path / "baltic.npy", rows))
    pooled = np.concatenate([row[0] for row in rows])[:, 2].std()
    assert voxel.sigma_z(read.clouds) == pytest.approx(pooled, rel=1e-6)


@pytest.mark.parametrize(
    ("cells", "cause"),
    [
        ({"points": np.zeros((4, 2))}, "its points are float64 of shape (4, 2), must be numbers of shape (n, 3)"),
        ({"points": np.zeros((0, 3))}, "must be numbers of shape (n, 3)"),
        ({"points": "points"}, "its points are of type str"),
        ({"points": 50 * authors_arrays.row(1)[0]}, "its farthest point is at 50, must be at 1"),
        ({"points": 0.01 * authors_arrays.row(1)[0]}, "its farthest point is at 0.01, must be at 1"),
        ({"points": np.full((4, 3), np.nan)}, "its farthest point is at nan"),
        ({"points": np.full((4, 3), np.inf)}, "its farthest point is at inf"),
        ({"prior": np.eye(3)}, "prior: is float64 of shape (3, 3), must be numbers of shape (2, 2)"),
        ({"posterior": -np.eye(2)}, "posterior: smallest eigenvalue"),
        ({"posterior": np.diag([1.0, 0.0])}, "posterior: smallest eigenvalue"),
        ({"posterior": np.full((2, 2), np.nan)}, "posterior: the covariance has an entry that is not a number"),
        ({"posterior": np.array([[2.0, 1.0], [0.5, 2.0]])}, "posterior: the covariance is not symmetric"),
        ({"posterior": 1e200 * np.eye(2)}, "posterior: has an entry of 1e+200 m^2"),
        ({"posterior": None}, "posterior: is of type NoneType"),
        ({"rho": np.float64(0)}, "rho is 0, must be a radius above 0"),
        ({"rho": np.nan}, "rho is nan, must be a radius"),
        ({"rho": 10**300}, "rho is of type int, must be a radius"),
        ({"rho": "12"}, "rho is of type str"),
        ({"rho": True}, "rho is of type bool"),
        ({"submap": 3}, "its last two cells are not the names of files"),
    ],
)
def test_a_row_that_is_none_is_named_with_its_file(tmp_path: Path, cells: dict[str, Any], cause: str):
    sentence = refusal(tmp_path, changed(**cells))
    assert sentence.startswith(", row 1")
    assert cause in sentence


def test_halves_of_a_covariance_may_differ_by_the_rounding_of_a_text(tmp_path: Path):
    posterior = np.array([[2.0, 0.333333], [0.333334, 1.0]])
    read = consolidated.read(authors_arrays.write(tmp_path / "borno.npy", changed(posterior=posterior)))
    gaussian.check(read.label[1], "test")
    np.testing.assert_allclose(read.label[1], posterior, atol=1e-6)


def test_rows_that_share_one_array_cannot_multiply_it(tmp_path: Path):
    row = authors_arrays.row(0, points=4000)
    sentence = refusal(tmp_path, [row] * 200)
    assert "its points were those of rows before" in sentence


def test_files_are_joined_for_training_in_their_order(tmp_path: Path):
    rows_by_file = {
        name: consolidated.read(authors_arrays.write(tmp_path / f"{name}.npy", authors_arrays.rows(count, seed=count)))
        for name, count in (("baltic", 3), ("borno", 2))
    }
    joined = consolidated.samples(rows_by_file)
    assert joined.survey.tolist() == ["baltic"] * 3 + ["borno"] * 2
    assert joined.submap.tolist() == [0, 1, 2, 0, 1]
    np.testing.assert_array_equal(joined.clouds[4], rows_by_file["borno"].clouds.cloud(1).points)
    np.testing.assert_array_equal(joined.radius[3:], rows_by_file["borno"].clouds.radius)
    np.testing.assert_array_equal(joined.label[:3], rows_by_file["baltic"].label)


def test_a_file_without_rows_is_refused(tmp_path: Path):
    np.save(tmp_path / "borno.npy", np.empty((0, 6), object), allow_pickle=True)
    with pytest.raises(consolidated.ConsolidatedError, match=r"borno\.npy: has no rows"):
        consolidated.read(tmp_path / "borno.npy")


def test_a_prior_that_is_not_the_paper_s_is_reported(tmp_path: Path):
    read = consolidated.read(authors_arrays.write(tmp_path / "baltic.npy", authors_arrays.rows(3)))
    assert read.prior_note() == ""
    sampled = changed(prior=np.diag([8.8, 9.3]))
    assert consolidated.read(authors_arrays.write(tmp_path / "a.npy", sampled)).prior_note() == ""
    other = consolidated.read(authors_arrays.write(tmp_path / "b.npy", changed(prior=3 * np.eye(2))))
    expected = "1 of 3 priors are not the paper's 9 I m^2, the farthest is [[3.0, 0.0], [0.0, 3.0]]"
    assert other.prior_note() == expected


def test_a_submap_that_is_trained_on_cannot_be_tested_on(tmp_path: Path):
    training = consolidated.read(authors_arrays.write(tmp_path / "borno.npy", authors_arrays.rows(4)))
    unseen = consolidated.read(authors_arrays.write(tmp_path / "a.npy", authors_arrays.rows(4, seed=1)))
    consolidated.check_unseen(unseen, training, ("a.npy", "borno.npy"))
    seen = authors_arrays.rows(4, seed=1)[:2] + authors_arrays.rows(4)[2:3]
    mixed = consolidated.read(authors_arrays.write(tmp_path / "b.npy", seen))
    with pytest.raises(consolidated.ConsolidatedError, match=r"b\.npy, row 2: is row 2 of borno\.npy"):
        consolidated.check_unseen(mixed, training, ("b.npy", "borno.npy"))


def test_a_damaged_file_ends_in_a_sentence_or_in_covariances(tmp_path: Path):
    good = np.frombuffer(authors_arrays.write(tmp_path / "good.npy", authors_arrays.rows(2)).read_bytes(), np.uint8)
    rng = np.random.default_rng(1)
    sentences = []
    for number in range(400):
        spoilt = good[: rng.integers(len(good))].copy() if number % 4 == 0 else good.copy()
        if len(spoilt):
            spoilt[rng.integers(len(spoilt))] ^= np.uint8(1 << rng.integers(8))
        (tmp_path / "bad.npy").write_bytes(spoilt.tobytes())
        try:
            read = consolidated.read(tmp_path / "bad.npy")
        except PointNetKLError as error:
            sentences.append(str(error))
        else:
            assert np.isfinite(read.clouds.points).all()
            assert (np.linalg.eigvalsh(read.label) > 0).all()
    assert len(sentences) > 100
    assert all(sentence.startswith(str(tmp_path / "bad.npy")) and "\n" not in sentence for sentence in sentences)
