"""Submaps are equal pieces of a survey, in frames of their own, and lose nothing in silence."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import whole_survey
from pointnetkl import segmentation
from pointnetkl.segmentation import SegmentationError, Settings, spacing, track
from pointnetkl.segmentation.soundings import SoundingsError
from pointnetkl.surveys import pose, survey
from pointnetkl.surveys.submap import POINTS, POSES, from_table, to_table
from pointnetkl.workflow import artifacts
from small_survey import sail
from whole_survey import Cut, Whole

SPACING_M = 4.0
ROOT = Path(__file__).parents[2]


def cut(survey: Whole, length_m: float = 100.0, seed: int = 1) -> Cut:
    return whole_survey.cut(
        segmentation.segment, "small", survey.pings, [survey.soundings], length_m, SPACING_M, Settings(seed, 30.0)
    )


@pytest.fixture(scope="module")
def small() -> Whole:
    return sail()


@pytest.fixture(scope="module")
def segments(small: Whole) -> Cut:
    return cut(small)


def map_points(segments: Cut, number: int, points: np.ndarray) -> np.ndarray:
    row = segments.poses.iloc[number]
    return pose.transform(pose.matrix(row[["x_m", "y_m", "z_m"]].to_numpy(float), row["yaw_rad"]), points)


def test_every_submap_has_the_same_track_length(small: Whole, segments: Cut):
    assert len(segments.submaps) == 6
    assert (segments.poses["track_m"] == 100.0).all()
    assert segments.poses["pings"].between(100, 101).all()
    assert segments.poses["pings"].sum() == len(small.pings)


def test_the_end_of_a_line_is_a_submap_from_nine_tenths_of_a_length_on_and_else_counted():
    nearly = cut(sail(line_m=295.0))
    assert nearly.poses["track_m"].tolist() == pytest.approx([100.0, 100.0, 95.0] * 2)
    short = cut(sail(line_m=260.0))
    assert short.poses["track_m"].tolist() == [100.0] * 4
    assert short.dropped["ends of lines shorter than 0.9 of a submap"] == 2
    assert short.poses["pings"].sum() + short.dropped["pings in them"] == 2 * 261


def test_a_gap_and_a_turn_that_was_not_logged_end_a_line():
    assert cut(sail(apart_m=60.0)).poses["line"].tolist() == [0, 0, 0, 1, 1, 1]
    assert cut(sail(apart_m=10.0)).poses["line"].tolist() == [0, 0, 0, 1, 1, 1]  # nearer than the longest gap


def test_a_submap_on_a_turn_is_dropped_and_counted():
    angle = np.linspace(0, 2 * np.pi, 101)  # a loop of 100 m
    loop = track.cut(100 / (2 * np.pi) * np.c_[np.sin(angle), -np.cos(angle)], angle, 99.9, 30.0, 9.0)
    assert [stretch.straight for stretch in loop.stretches] == [False]


def test_the_frame_stands_at_the_middle_ping_and_points_along_the_track(small: Whole, segments: Cut):
    for row in segments.poses.itertuples():
        ping = small.pings[small.pings["time_s"] == row.time_s].iloc[0]
        assert (row.x_m, row.y_m, row.z_m) == (ping["x_m"], ping["y_m"], ping["z_m"])
        assert np.cos(row.yaw_rad - ping["yaw_rad"]) == pytest.approx(1.0)
    for cloud in segments.submaps:
        extent = np.ptp(cloud.points, axis=0)
        assert extent[0] == pytest.approx(100, abs=2)
        assert extent[1] == pytest.approx(80, abs=4)
        assert abs(cloud.points[:, 0].mean()) < 2  # the middle ping is in the middle


def test_noisy_headings_do_not_turn_the_frame(small: Whole, segments: Cut):
    noise = 0.1 * np.random.default_rng(3).standard_normal(len(small.pings))
    noisy = Whole(small.pings.assign(yaw_rad=small.pings["yaw_rad"] + noise), small.soundings)
    assert cut(noisy).poses.equals(segments.poses)


def test_points_keep_their_place_on_the_map(small: Whole, segments: Cut):
    everywhere = small.soundings[["x_m", "y_m", "z_m"]].to_numpy()
    for cloud in segments.submaps:
        distance, _ = spacing.cKDTree(everywhere).query(map_points(segments, cloud.number, cloud.points))
        assert distance.max() < 1e-9


def test_the_halves_come_from_alternate_pings(small: Whole, segments: Cut):
    xyz, ping = small.soundings[["x_m", "y_m", "z_m"]].to_numpy(), small.soundings["ping"].to_numpy()
    tree = spacing.cKDTree(xyz)
    for cloud in segments.submaps:
        first, second = (
            ping[tree.query(map_points(segments, cloud.number, half))[1]] for half in (cloud.first, cloud.second)
        )
        assert len(set(first % 2)) == len(set(second % 2)) == 1
        assert first[0] % 2 != second[0] % 2


def test_the_two_heads_of_a_sonar_stay_in_one_half(small: Whole):
    # each ping of the small survey becomes two at one time, one of its port beams, one of its starboard beams
    starboard = small.soundings["beam"] >= 30
    pings = small.pings.loc[small.pings.index.repeat(2)].assign(ping=np.arange(2 * len(small.pings), dtype=np.int32))
    soundings = small.soundings.assign(ping=2 * small.soundings["ping"] + starboard)
    segments = cut(Whole(pings, soundings))
    for cloud in segments.submaps:
        for half in (cloud.first, cloud.second):
            assert np.mean(half[:, 1] > 0) == pytest.approx(0.5, abs=0.05)
    complete = cut(small)
    assert all(np.array_equal(a.first, b.first) for a, b in zip(segments.submaps, complete.submaps, strict=True))


def test_thinning_leaves_one_point_in_every_occupied_cell(small: Whole, segments: Cut):
    for cloud in segments.submaps:
        for part in (cloud.points, cloud.first, cloud.second):
            assert len(np.unique(spacing.cells(part, SPACING_M))) == len(part)
    everything = np.random.default_rng(0).uniform(-30, 30, (5000, 3))
    thinned = everything[spacing.thin(everything, SPACING_M, np.random.default_rng(0))]
    assert len(thinned) == len(np.unique(spacing.cells(everything, SPACING_M)))


def test_thinning_prefers_no_sounding_of_a_cell():
    points = np.tile([[0.1, 0.1, 0.0], [0.2, 0.2, 0.0], [0.3, 0.3, 0.0]], (3000, 1))
    points[:, 0] += np.repeat(np.arange(3000), 3)
    drawn = spacing.thin(points, 1.0, np.random.default_rng(0)) % 3
    assert np.bincount(drawn, minlength=3) == pytest.approx([1000, 1000, 1000], abs=100)


def test_parts_of_any_size_give_the_same_submaps(small: Whole, segments: Cut):
    for rows in (1000, 7777, 10**6):
        parts = [small.soundings[begin : begin + rows] for begin in range(0, len(small.soundings), rows)]
        other = whole_survey.cut(segmentation.segment, "small", small.pings, parts, 100.0, SPACING_M, Settings(1, 30.0))
        assert other.poses.equals(segments.poses)
        assert to_table(other.submaps).equals(to_table(segments.submaps))
        assert other.dropped == segments.dropped


def test_soundings_out_of_the_order_of_pings_are_refused(small: Whole):
    with pytest.raises(SoundingsError, match="not in order of ping"):
        cut(Whole(small.pings, small.soundings.sample(frac=1, random_state=5)))


def test_another_seed_draws_other_soundings(small: Whole, segments: Cut):
    other = cut(small, seed=2)
    assert other.poses.equals(segments.poses)
    assert not np.array_equal(other.submaps[0].points, segments.submaps[0].points)


def test_a_blunder_is_left_out_and_a_rock_is_kept(small: Whole):
    soundings = small.soundings.copy()
    x, y = soundings["x_m"], soundings["y_m"]
    rock = np.hypot(x - x.iloc[3030], y - y.iloc[3030]) < 3
    soundings.loc[rock, "z_m"] += 8
    blunders = np.arange(500, len(soundings), 997)
    soundings.loc[blunders, "z_m"] -= 8
    remaining = cut(Whole(small.pings, soundings))
    assert len(blunders) == remaining.dropped["soundings standing alone"]
    assert max(cloud.points[:, 2].max() for cloud in remaining.submaps) > -62 + 20 + 8


def test_a_wall_loses_no_sounding():
    wall = sail(lines=1, seabed=lambda x, y: np.where(x + 0.3 * y > 150, -30.0, -70.0))
    assert cut(wall).dropped["soundings standing alone"] == 0


def test_a_sounding_far_from_the_swath_is_left_out():
    points = np.c_[np.random.default_rng(0).uniform(0, 50, (2000, 2)), np.zeros(2000)]
    points[7, :2] = 400.0
    assert np.flatnonzero(spacing.outlying(points, SPACING_M)).tolist() == [7]


def test_soundings_of_bad_quality_or_without_a_position_are_left_out_and_counted(small: Whole):
    soundings = small.soundings.copy()
    soundings.loc[:9, "quality"] = 1
    soundings.loc[10:14, "z_m"] = np.nan
    soundings.loc[15, "x_m"] = 1e30
    dropped = cut(Whole(small.pings, soundings)).dropped
    assert (dropped["soundings of bad quality"], dropped["soundings without a valid position"]) == (10, 6)


def test_a_submap_of_too_few_points_is_dropped_and_the_numbers_stay_consecutive(small: Whole, segments: Cut):
    sparse = small.soundings[~small.soundings["ping"].between(100, 198) | (small.soundings["beam"] == 30)]
    remaining = cut(Whole(small.pings, sparse))
    assert remaining.dropped["submaps of too few points"] == 1
    assert remaining.poses["submap"].tolist() == [cloud.number for cloud in remaining.submaps] == [0, 1, 2, 3, 4]
    assert remaining.poses["time_s"].tolist() == segments.poses["time_s"].drop(1).tolist()


def test_a_survey_too_short_says_how_long_it_is_and_what_to_change():
    with pytest.raises(SegmentationError, match=r"small: its longest line .* 50 m.* 100 m; lower study.surveys.small"):
        cut(sail(line_m=50.0))


def test_a_survey_that_cannot_be_cut_says_why(small: Whole):
    nowhere = small.pings.assign(x_m=small.pings["x_m"].where(small.pings["ping"] != 7))
    cases = [
        (small.pings, small.soundings.assign(quality=np.int8(1)), "none of its 36120 soundings has quality 0"),
        (small.pings.iloc[:0], small.soundings, "has no pings"),
        (small.pings.iloc[[0, *range(len(small.pings))]], small.soundings, "ping 0 stands twice"),
        (nowhere, small.soundings, "1 of its 602 pings have no valid position, the first of them ping 7"),
        (small.pings, small.soundings.assign(ping=small.soundings["ping"] + 1), "60 soundings belong to no ping"),
        (small.pings, small.soundings[::300], "no submap has 50 points or more"),
    ]
    for pings, soundings, message in cases:
        with pytest.raises((SegmentationError, SoundingsError), match=message):
            cut(Whole(pings, soundings))


def segment_stage(folder: Path, name: str = "small") -> subprocess.CompletedProcess[str]:
    paths = ["--survey", ".", "--submaps", "submaps.parquet", "--poses", "poses.parquet"]
    script = [sys.executable, ROOT / "pipeline/segment.py", name, *paths]
    return subprocess.run(script, cwd=folder, capture_output=True, text=True, check=False)


@pytest.mark.slow
def test_the_stage_writes_submaps_and_poses_or_says_what_is_wrong(tmp_path: Path, small: Whole):
    artifacts.write_table(tmp_path / "pings.parquet", small.pings, survey.PINGS, {})
    artifacts.write_table(tmp_path / "soundings.parquet", small.soundings, survey.SOUNDINGS, {})
    line = "{group: train, raw: a, truth: data/none, submap_length_m: 100, point_spacing_m: 4.0, label_runs: 9}"
    params = f"segment: {{seed: 1, max_gap_m: 30.0}}\nstudy: {{train: {{small: {line}}}, surveys: {{small: {line}}}}}\n"
    (tmp_path / "params.yaml").write_text(params)
    done = segment_stage(tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("small: 6 submaps of ")
    submaps = from_table("small", artifacts.read_table(tmp_path / "submaps.parquet", POINTS))
    assert [cloud.number for cloud in submaps] == artifacts.read_table(tmp_path / "poses.parquet", POSES)[
        "submap"
    ].tolist()
    assert artifacts.table_metadata(tmp_path / "poses.parquet")["params"]["point_spacing_m"] == 4.0
    unknown = segment_stage(tmp_path, "smal")
    assert unknown.returncode == 1
    assert unknown.stderr == "error: params.yaml: there is no study.surveys.smal; at 'smal' the file has small\n"


def test_the_spacing_of_a_lattice_is_its_step():
    x, y = np.meshgrid(2.0 * np.arange(9), 3.0 * np.arange(9))
    assert spacing.between_neighbours(np.c_[x.ravel(), y.ravel(), 0 * x.ravel()]) == 2.0
