"""Points without pings become tiles, submaps that are cut already stay as they are; both are thinned as swaths are."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import whole_survey
from pointnetkl import segmentation
from pointnetkl.segmentation import Segmentation, Settings, spacing, tiles
from pointnetkl.segmentation.soundings import SoundingsError
from pointnetkl.segmentation.tiles import TilesError
from pointnetkl.surveys import pose, submap, survey
from pointnetkl.surveys.submap import Submap
from pointnetkl.workflow import artifacts
from whole_survey import Cut

ROOT = Path(__file__).parents[2]
EDGE_M, SPACING_M = 50.0, 2.0


def seabed(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return -30 + 0.05 * x + 2 * np.sin(x / 9) * np.cos(y / 7)


def surface(points: int = 40_000, extent_m: tuple[float, float] = (200.0, 100.0), seed: int = 0) -> pd.DataFrame:
    """Return soundings of no ping, spread evenly over a rectangle whose first corner is the map's origin."""
    x, y = (np.random.default_rng(seed).uniform(0, 1, (points, 2)) * extent_m).T
    placed = {"x_m": x, "y_m": y, "z_m": seabed(x, y)}
    return pd.DataFrame({"ping": -1, "beam": 0, **placed, "quality": np.int8(0)}).astype({"ping": np.int32})


def cut(
    points: pd.DataFrame, rows: int = 10**6, seed: int = 1, spacing_m: float = SPACING_M
) -> tuple[list[Submap], Segmentation]:
    parts = [points[begin : begin + rows] for begin in range(0, len(points), rows)]
    submaps: list[Submap] = []
    return submaps, tiles.segment("shoal", parts, EDGE_M, spacing_m, seed, submaps.append)


@pytest.fixture(scope="module")
def points() -> pd.DataFrame:
    return surface()


@pytest.fixture(scope="module")
def tiled(points: pd.DataFrame) -> tuple[list[Submap], Segmentation]:
    return cut(points)


def test_tiles_cover_a_surface_row_by_row_to_and_fro(tiled: tuple[list[Submap], Segmentation]):
    submaps, tiling = tiled
    assert [cloud.number for cloud in submaps] == tiling.poses["submap"].tolist() == list(range(8))
    assert tiling.poses["x_m"].tolist() == [25.0, 75.0, 125.0, 175.0, 175.0, 125.0, 75.0, 25.0]
    assert tiling.poses["y_m"].tolist() == [25.0] * 4 + [75.0] * 4
    assert tiling.poses["line"].tolist() == [0] * 4 + [1] * 4


def test_a_tile_s_frame_is_at_its_centre_and_its_points_mean_height(tiled: tuple[list[Submap], Segmentation]):
    for cloud, place in zip(tiled[0], tiled[1].poses.itertuples(), strict=True):
        assert np.abs(cloud.points[:, :2]).max() <= EDGE_M / 2
        assert cloud.points[:, 2] + place.z_m == pytest.approx(
            seabed(cloud.points[:, 0] + place.x_m, cloud.points[:, 1] + place.y_m)
        )
        assert abs(cloud.points[:, 2].mean()) < 0.2


def test_points_that_nobody_pinged_have_neither_time_nor_pings(tiled: tuple[list[Submap], Segmentation]):
    poses = tiled[1].poses
    assert poses["time_s"].isna().all()
    assert (poses[["pings", "yaw_rad"]] == 0).all(axis=None)
    assert (poses["track_m"] == EDGE_M).all()
    assert poses["soundings"].sum() == 40_000


def test_every_tile_has_one_point_in_each_cell_and_so_have_its_halves(tiled: tuple[list[Submap], Segmentation]):
    for cloud in tiled[0]:
        for part in (cloud.points, cloud.first, cloud.second):
            assert len(np.unique(spacing.cells(part, SPACING_M))) == len(part)
        assert len(cloud.points) == pytest.approx((EDGE_M / SPACING_M) ** 2, rel=0.1)
        assert min(len(cloud.first), len(cloud.second)) > 0.95 * len(cloud.points)


def test_no_point_is_in_both_halves(tiled: tuple[list[Submap], Segmentation]):
    for cloud in tiled[0]:
        assert not set(map(tuple, cloud.first)) & set(map(tuple, cloud.second))


def test_tiles_do_not_depend_on_how_the_points_come_in_parts(
    points: pd.DataFrame, tiled: tuple[list[Submap], Segmentation], monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(tiles, "_FLUSHED", 3000)
    for rows in (777, 10_000):
        submaps, tiling = cut(points, rows)
        assert tiling.poses.equals(tiled[1].poses)
        assert submap.to_table(submaps).equals(submap.to_table(tiled[0]))


def test_another_seed_draws_other_points(points: pd.DataFrame, tiled: tuple[list[Submap], Segmentation]):
    assert not np.array_equal(cut(points, seed=2)[0][0].points, tiled[0][0].points)


def test_a_blunder_and_points_of_bad_quality_are_left_out_and_counted(points: pd.DataFrame):
    spoilt = points.copy()
    spoilt.loc[:99, "quality"] = 1
    spoilt.loc[100:104, "z_m"] = np.nan
    spoilt.loc[200:205, "z_m"] += 100.0
    submaps, tiling = cut(spoilt)
    assert tiling.dropped["soundings of bad quality"] == 100
    assert tiling.dropped["soundings without a valid position"] == 5
    assert tiling.dropped["soundings standing alone"] == 6
    assert max(cloud.points[:, 2].max() for cloud in submaps) < 20


def test_a_tile_at_the_edge_of_the_surface_is_dropped_and_counted():
    submaps, tiling = cut(surface(30_000, (115.0, 50.0)))
    assert len(submaps) == 2
    assert tiling.dropped["tiles of which points cover less than half"] == 1
    submaps, tiling = cut(pd.concat([surface(), surface(20, (5.0, 5.0)).assign(x_m=lambda rows: rows["x_m"] + 900.0)]))
    assert len(submaps) == 8
    assert tiling.dropped["tiles of too few points"] == 1


def test_tiles_on_both_sides_of_the_origin_are_of_one_size(points: pd.DataFrame):
    moved = points.assign(x_m=points["x_m"] - 100.0, y_m=points["y_m"] - 50.0)
    submaps, tiling = cut(moved)
    assert tiling.poses["x_m"].tolist()[:4] == [-75.0, -25.0, 25.0, 75.0]
    assert max(len(cloud.points) for cloud in submaps) < 1.1 * min(len(cloud.points) for cloud in submaps)


def test_points_too_sparse_for_their_spacing_say_how_dense_they_are():
    with pytest.raises(TilesError, match=r"shoal: no tile of 50 m has 50 points .* 2 m, .* has 3\d, one in 8\.\d+ m"):
        cut(surface(200))
    with pytest.raises(SoundingsError, match="none of its 200 soundings has quality 0"):
        cut(surface(200).assign(quality=np.int8(1)))


def test_halves_share_every_cell_of_two_points_and_one_of_them_has_a_single_point():
    rng = np.random.default_rng(0)
    points = rng.uniform(0, 30, (1500, 3))
    second = spacing.alternate(points, 1.0, rng)
    cell = np.unique(spacing.cells(points, 1.0), return_inverse=True)[1]
    in_first, in_second = np.bincount(cell[~second], minlength=cell.max() + 1), np.bincount(cell[second])
    assert np.abs(in_first[: len(in_second)] - in_second).max() <= 1
    alone = np.bincount(cell)[cell] == 1
    assert 0.4 < second[alone].mean() < 0.6


def test_halves_of_a_grid_have_no_direction():
    x, y = np.mgrid[0.5:40, 0.5:40].reshape(2, -1)
    second = spacing.alternate(np.c_[x, y, 0 * x], 1.0, np.random.default_rng(3))
    for line in (x, y):
        share = np.bincount(line.astype(int), second) / 40
        assert share.std() < 0.12


def ready(numbers: int = 3, points: int = 3000) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Return submaps that another program has cut, as pings and their soundings in the map frame."""
    rng = np.random.default_rng(5)
    rows, parts = [], []
    for i in range(numbers):
        rows.append((i, float(i), 30.0 * i, 40.0 * i, 4.5, 0.0, 0.0, 0.3 * i, f"submap_{i}.pcd"))
        local = np.c_[rng.uniform(-20, 20, (points, 2)), np.zeros(points)]
        local[:, 2] = np.sin(local[:, 0] / 5) - 9.0
        x, y, z = pose.transform(pose.matrix(np.array(rows[-1][2:5]), 0.3 * i), local).T
        parts.append(pd.DataFrame({"ping": i, "beam": np.arange(points), "x_m": x, "y_m": y, "z_m": z, "quality": 0}))
    return pd.DataFrame(rows, columns=survey.PINGS.names), pd.concat(parts, ignore_index=True)


def keep(pings: pd.DataFrame, soundings: pd.DataFrame) -> Cut:
    return whole_survey.cut(segmentation.keep, "toy", pings, [soundings], SPACING_M, Settings(1, 30.0))


def test_submaps_of_another_program_keep_their_cut_and_their_frame():
    pings, soundings = ready()
    segments = keep(pings, soundings)
    assert segments.poses["soundings"].tolist() == [3000] * 3
    for name in ("x_m", "y_m", "z_m", "yaw_rad"):
        assert segments.poses[name].tolist() == pings[name].tolist()
    assert segments.poses["track_m"].tolist()[:2] == pytest.approx([50.0, 50.0])
    assert np.isnan(segments.poses["track_m"].iloc[-1])
    for cloud in segments.submaps:
        assert cloud.points[:, 2] == pytest.approx(np.sin(cloud.points[:, 0] / 5) - 9.0)
        assert np.ptp(cloud.points[:, :2], axis=0) == pytest.approx([40, 40], abs=2)
        assert not set(map(tuple, cloud.first)) & set(map(tuple, cloud.second))


def test_a_submap_of_another_program_with_too_few_points_is_dropped_and_counted():
    pings, soundings = ready()
    segments = keep(pings, soundings[(soundings["ping"] != 1) | (soundings["beam"] < 30)])
    assert segments.dropped["submaps of too few points"] == 1
    assert segments.poses["time_s"].tolist() == [0.0, 2.0]


def segment_stage(folder: Path, kind: str, soundings: pd.DataFrame, pings: pd.DataFrame | None = None) -> str:
    """Run the stage on a survey of a kind; return the last line that it says."""
    pings = survey.PINGS.empty_table().to_pandas() if pings is None else pings
    artifacts.write_table(folder / "pings.parquet", pings, survey.PINGS, {"kind": kind})
    artifacts.write_table(folder / "soundings.parquet", soundings, survey.SOUNDINGS, {"kind": kind})
    lengths = f"submap_length_m: {EDGE_M}, point_spacing_m: {SPACING_M}"
    line = f"{{group: train, raw: a, truth: data/none, {lengths}, label_runs: 9}}"
    (folder / "params.yaml").write_text(
        f"segment: {{seed: 1, max_gap_m: 30.0}}\nstudy: {{train: {{shoal: {line}}}, surveys: {{shoal: {line}}}}}\n"
    )
    paths = ["--survey", ".", "--submaps", "submaps.parquet", "--poses", "poses.parquet"]
    script = [sys.executable, ROOT / "pipeline/segment.py", "shoal", *paths]
    done = subprocess.run(script, cwd=folder, capture_output=True, text=True, check=False)
    return (done.stdout or done.stderr).strip().splitlines()[-1]


@pytest.mark.slow
def test_the_stage_takes_its_way_by_the_kind_of_the_survey(
    tmp_path: Path, points: pd.DataFrame, tiled: tuple[list[Submap], Segmentation]
):
    assert segment_stage(tmp_path, "points", points).startswith("shoal: 8 submaps of ")
    written = submap.from_table("shoal", artifacts.read_table(tmp_path / "submaps.parquet", submap.POINTS))
    assert np.array_equal(written[3].points.astype(np.float32), tiled[0][3].points.astype(np.float32))
    assert artifacts.read_table(tmp_path / "poses.parquet", submap.POSES).equals(
        tiled[1].poses.astype({"submap": "int32", "pings": "int32", "soundings": "int32", "line": "int32"})
    )
    assert artifacts.table_metadata(tmp_path / "submaps.parquet")["params"]["point_spacing_m"] == SPACING_M
    assert not list(tmp_path.glob(".tiles-*"))
    pings, soundings = ready()
    assert segment_stage(tmp_path, "submaps", soundings, pings).startswith("shoal: 3 submaps of ")
    says = segment_stage(tmp_path, "mesh", points)
    assert says == (
        "error: pings.parquet: is of kind 'mesh', must be pings, points or submaps; run dvc repro ingest@shoal"
    )
