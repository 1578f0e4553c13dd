"""Submaps are the same after being stored as a table."""

from pathlib import Path

import numpy as np
import pytest

from pointnetkl.surveys import submap
from pointnetkl.surveys.submap import Submap, SubmapError
from pointnetkl.workflow import artifacts


def make(number: int, sizes: tuple[int, int, int] = (30, 14, 16)) -> Submap:
    rng = np.random.default_rng(number)
    points, first, second = (rng.normal(0, 50, (size, 3)) for size in sizes)
    return Submap("small", number, points, first, second)


def test_submaps_come_back_from_the_file_by_number_to_single_precision(tmp_path: Path):
    submaps = [make(3), make(0), make(12)]
    artifacts.write_table(tmp_path / "s.parquet", submap.to_table(submaps), submap.POINTS, {})
    stored = submap.from_table("small", artifacts.read_table(tmp_path / "s.parquet", submap.POINTS))
    assert [cloud.number for cloud in stored] == [0, 3, 12]
    for cloud, other in zip(stored, sorted(submaps, key=lambda s: s.number), strict=True):
        for name in ("points", "first", "second"):
            assert getattr(cloud, name) == pytest.approx(getattr(other, name), rel=1e-6, abs=1e-6)
            assert getattr(cloud, name).dtype == np.float64


def test_a_submap_without_halves_has_empty_ones():
    stored = submap.from_table("small", submap.to_table([make(1, (5, 0, 0))]))
    assert stored[0].points.shape == (5, 3)
    assert stored[0].first.shape == stored[0].second.shape == (0, 3)


def test_no_submaps_make_an_empty_table():
    assert submap.from_table("small", submap.to_table([])) == []


def same(cloud: Submap, other: Submap) -> bool:
    return cloud.number == other.number and all(
        np.array_equal(getattr(cloud, name), getattr(other, name)) for name in ("points", "first", "second")
    )


@pytest.mark.parametrize("sizes", [(30, 14, 16), (20000, 9000, 11000), (70000, 0, 0), (32768, 16384, 16384)])
def test_submaps_read_one_by_one_are_those_of_the_whole_table(tmp_path: Path, sizes: tuple[int, int, int]):
    # larger and smaller than a row group of the file, and just as large
    path = tmp_path / "s.parquet"
    artifacts.write_table(path, submap.to_table(make(n, sizes) for n in (0, 3, 4, 12)), submap.POINTS, {})
    stored = submap.from_table("small", artifacts.read_table(path, submap.POINTS))
    assert all(map(same, submap.stream("small", path), stored))
    assert [cloud.number for cloud in submap.stream("small", path)] == [0, 3, 4, 12]
    assert all(same(submap.read("small", path, cloud.number), cloud) for cloud in stored)


def test_a_file_without_submaps_has_none(tmp_path: Path):
    artifacts.write_table(tmp_path / "s.parquet", submap.to_table([]), submap.POINTS, {})
    assert list(submap.stream("small", tmp_path / "s.parquet")) == []
    with pytest.raises(SubmapError, match=r"s\.parquet: has no submap 3; run dvc repro segment@small"):
        submap.read("small", tmp_path / "s.parquet", 3)


def test_rows_that_are_not_sorted_by_submap_are_refused(tmp_path: Path):
    artifacts.write_table(tmp_path / "s.parquet", submap.to_table([make(3), make(0)]), submap.POINTS, {})
    with pytest.raises(SubmapError, match="not sorted"):
        list(submap.stream("small", tmp_path / "s.parquet"))


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_point_that_is_nowhere_is_refused_with_its_submap(tmp_path: Path, bad: float):
    spoilt = make(3)
    spoilt.second[4, 2] = bad
    artifacts.write_table(tmp_path / "s.parquet", submap.to_table([make(0), spoilt]), submap.POINTS, {})
    for read in (
        lambda path: submap.from_table("small", artifacts.read_table(path, submap.POINTS)),
        lambda path: submap.read("small", path, 3),
        lambda path: list(submap.stream("small", path)),
    ):
        with pytest.raises(SubmapError, match="small: submap 3 has a point that is not finite"):
            read(tmp_path / "s.parquet")


def test_the_sampling_of_a_survey_travels_with_its_submaps(tmp_path: Path):
    path = tmp_path / "s.parquet"
    artifacts.write_table(path, submap.to_table([]), submap.POINTS, {"kind": "points", "spacing_m": 2.5})
    assert submap.read_sampling(path) == submap.Sampling("points", 2.5)
    artifacts.write_table(path, submap.to_table([]), submap.POINTS, {"kind": "points"})
    with pytest.raises(SubmapError, match="does not say its survey's kind and spacing_m"):
        submap.read_sampling(path)


@pytest.mark.parametrize("spacing", [float("nan"), -1.0, 0.0])
def test_a_spacing_that_makes_no_sense_is_refused(tmp_path: Path, spacing: float):
    path = tmp_path / "submaps.parquet"
    nothing = submap.POINTS.empty_table().to_pandas()
    artifacts.write_table(path, nothing, submap.POINTS, {"kind": "pings", "spacing_m": spacing})
    with pytest.raises(submap.SubmapError, match=r"spacing_m is .*, must be a number above zero"):
        submap.read_sampling(path)
