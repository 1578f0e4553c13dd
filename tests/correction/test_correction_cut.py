"""A survey cut into submaps, whose points stay on disk."""

import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import raw_survey
from pointnetkl.correction.preparation import cut, inputs
from pointnetkl.correction.preparation.cut import Clouds, Cut
from pointnetkl.correction.preparation.inputs import Inputs
from pointnetkl.correction.settings import Settings
from pointnetkl.segmentation import SegmentationError
from pointnetkl.surveys import pose, submap
from pointnetkl.surveys.survey import SWATHS
from raw_survey import Plan

PLAN = Plan(lines=2)


def made(folder: Path, plan: Plan, settings: Settings | None = None) -> Cut:
    raw = raw_survey.write(folder / "raw", plan)
    for name in ("tables", "cut"):
        (folder / name).mkdir()
    inputs.ingest(Inputs([raw.folder]), "toy", settings or Settings(), folder / "tables")
    cut.cut("toy", folder / "tables", SWATHS, settings or Settings(), folder / "cut")
    return cut.read(folder / "cut")


@pytest.fixture(scope="module")
def pieces(tmp_path_factory: pytest.TempPathFactory) -> Cut:
    return made(tmp_path_factory.mktemp("pieces"), PLAN)


def test_clouds_on_disk_are_those_that_were_written(tmp_path: Path):
    rng = np.random.default_rng(0)
    written = [rng.normal(size=(size, 3)).astype("<f4") for size in (5, 0, 7)]
    (tmp_path / "points").write_bytes(b"".join(cloud.tobytes() for cloud in written))
    clouds = Clouds(tmp_path / "points", [5, 0, 7])
    assert len(clouds) == len(list(clouds)) == 3
    for k, cloud in enumerate(clouds):
        np.testing.assert_array_equal(cloud, written[k])
        assert cloud.dtype == np.float64
    for k in (3, -1):
        with pytest.raises(IndexError):
            clouds[k]


def test_clouds_are_sent_to_another_process_as_the_path(pieces: Cut):
    sent = pickle.dumps(pieces.clouds)
    assert len(sent) < 1000
    again = pickle.loads(sent)
    assert again.counts == pieces.clouds.counts
    np.testing.assert_array_equal(again[3], pieces.clouds[3])


def test_submaps_lie_on_the_seabed_at_their_poses(pieces: Cut):
    poses = submap.poses_from_table(pieces.poses)
    assert len(poses) == len(pieces.clouds) == 10
    origin = np.array([0.0, 0.0])  # the first ping is the map's origin
    for T, cloud in zip(poses, pieces.clouds, strict=True):
        x, y, z = pose.transform(T, cloud).T
        assert np.std(z - raw_survey.hills(x + origin[0], y + origin[1])) < 1.5 * PLAN.noise_m


def test_the_spacing_is_that_of_the_points_as_they_came_out(pieces: Cut):
    areas = PLAN.swath_m * pieces.sampling.length_m / np.array(pieces.clouds.counts)
    assert pieces.spacing_m == pytest.approx(np.sqrt(np.median(areas)), rel=0.35)
    assert pieces.spacing_m <= pieces.sampling.spacing_m


def test_submaps_of_a_dual_head_survey_are_those_of_the_single_head_one(tmp_path: Path, pieces: Cut):
    dual = made(tmp_path, replace(PLAN, heads=2))
    assert dual.sampling == pieces.sampling
    np.testing.assert_allclose(dual.poses[["time_s", "x_m", "y_m"]], pieces.poses[["time_s", "x_m", "y_m"]])
    np.testing.assert_allclose(dual.clouds.counts, pieces.clouds.counts, rtol=0.02)


def test_what_is_asked_for_is_done_and_said(tmp_path: Path, pieces: Cut):
    asked = made(tmp_path, PLAN, Settings(submap_length_m=120.0, point_spacing_m=4.0))
    assert (asked.sampling.length_m, asked.sampling.spacing_m) == (120.0, 4.0)
    assert "as asked for: submaps of 120 m with a point every 4 m" in asked.sampling.reason
    assert len(asked.clouds) == 6
    per_metre = [np.sum(cut_.clouds.counts) / (len(cut_.clouds) * cut_.sampling.length_m) for cut_ in (asked, pieces)]
    assert per_metre[0] < 0.8 * per_metre[1]


def test_the_same_survey_is_cut_into_the_same_bytes(tmp_path: Path):
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        made(tmp_path / name, PLAN)
    for file in ("points.f32", "poses.parquet", "cut.json"):
        assert (tmp_path / "a" / "cut" / file).read_bytes() == (tmp_path / "b" / "cut" / file).read_bytes()


def test_a_survey_too_short_for_a_submap_is_refused_by_what_the_command_can_change(tmp_path: Path):
    with pytest.raises(SegmentationError, match="shorter than a submap of 1000 m") as ended:
        made(tmp_path, PLAN, Settings(submap_length_m=1000.0))
    for words in (cut.reason(ended.value), str(ended.value)):
        assert "1000 m" in words
    assert "study.surveys" not in cut.reason(ended.value)
