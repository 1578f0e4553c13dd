"""Submaps are the same after being stored as a table."""

from pathlib import Path

import numpy as np
import pytest

from pointnetkl import artifacts, submap
from pointnetkl.submap import Submap


def make(number: int, sizes: tuple[int, int, int] = (30, 14, 16)) -> Submap:
    rng = np.random.default_rng(number)
    whole, first, second = (rng.normal(0, 50, (size, 3)) for size in sizes)
    return Submap("small", number, whole, first, second)


def test_submaps_come_back_from_the_file_by_number_to_single_precision(tmp_path: Path):
    made = [make(3), make(0), make(12)]
    artifacts.write_table(tmp_path / "s.parquet", submap.to_table(made), submap.POINTS, {})
    found = submap.from_table("small", artifacts.read_table(tmp_path / "s.parquet", submap.POINTS))
    assert [one.number for one in found] == [0, 3, 12]
    for one, other in zip(found, sorted(made, key=lambda s: s.number), strict=True):
        for name in ("points", "first", "second"):
            assert getattr(one, name) == pytest.approx(getattr(other, name), rel=1e-6, abs=1e-6)
            assert getattr(one, name).dtype == np.float64


def test_a_submap_without_halves_has_empty_ones():
    found = submap.from_table("small", submap.to_table([make(1, (5, 0, 0))]))
    assert found[0].points.shape == (5, 3)
    assert found[0].first.shape == found[0].second.shape == (0, 3)


def test_no_submaps_make_an_empty_table():
    assert submap.from_table("small", submap.to_table([])) == []
