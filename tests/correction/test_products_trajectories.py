"""trajectory.tum and covariances.txt, parsed by hand."""

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

import corrected_survey
from pointnetkl.correction.products import trajectories
from pointnetkl.correction.products.placed import Placed
from pointnetkl.correction.result import Corrected
from pointnetkl.exchange import tum


def rows_of(path: Path) -> np.ndarray:
    return np.array([line.split() for line in path.read_text().splitlines() if line[0] != "#"], np.float64)


def written(path: Path, survey: Corrected) -> np.ndarray:
    trajectories.write_tum(path / "a.tum", Placed(survey))
    return rows_of(path / "a.tum")


def test_pings_at_equal_times_count_once(tmp_path: Path):
    one, two = corrected_survey.corrected(), corrected_survey.corrected(heads=2)
    np.testing.assert_array_equal(written(tmp_path, two), written(tmp_path, one))
    assert len(tum.read(tmp_path / "a.tum")[0]) == len(one.track)


def test_poses_are_corrected_in_the_map_frame_and_the_origin_is_stated(tmp_path: Path):
    survey = corrected_survey.corrected()
    rows, after = written(tmp_path, survey), corrected_survey.after(survey.track)
    np.testing.assert_allclose(rows[:, 0], survey.track["time_s"], rtol=0, atol=1e-6)
    np.testing.assert_allclose(rows[:, 1:3], after[:, :2], atol=1e-12)
    np.testing.assert_allclose(rows[:, 3], survey.track["z_m"], atol=1e-12)
    comment = (tmp_path / "a.tum").read_text().splitlines()[0]
    assert "from the origin 600000.0 6000000.0 of EPSG:32633" in comment
    assert "UTC seconds since 1970" in comment


def test_the_body_turns_port_up_by_its_roll_and_bow_up_by_its_pitch(tmp_path: Path):
    track = corrected_survey.corrected().track.assign(yaw_rad=0.7, moved_yaw_rad=0.1, roll_rad=0.2, pitch_rad=0.3)
    rows = written(tmp_path, corrected_survey.with_track(corrected_survey.corrected(), **track.to_dict("series")))
    bow, port, _ = Rotation.from_quat(rows[0, 4:]).as_matrix().T
    assert np.isclose(np.arctan2(bow[1], bow[0]), 0.8)
    assert np.isclose(bow[2], np.sin(0.3))
    assert np.isclose(port[2], np.cos(0.3) * np.sin(0.2))


def test_roll_and_pitch_that_are_not_recorded_are_zero(tmp_path: Path):
    survey = corrected_survey.with_track(corrected_survey.corrected(), roll_rad=np.nan, pitch_rad=np.nan)
    rows = written(tmp_path, survey)
    np.testing.assert_allclose(rows[:, 4:6], 0.0, atol=1e-15)
    yaw = 2 * np.arctan2(rows[:, 6], rows[:, 7])
    np.testing.assert_allclose(np.cos(yaw - corrected_survey.after(survey.track)[:, 2]), 1.0)


def test_covariances_have_yaw_x_y_and_are_unknown_elsewhere(tmp_path: Path):
    survey = corrected_survey.corrected()
    assert survey.submaps is not None
    trajectories.write_covariances(tmp_path / "c.txt", survey, survey.submaps)
    names = (tmp_path / "c.txt").read_text().splitlines()[0].split()[1:]
    rows = rows_of(tmp_path / "c.txt")
    assert rows.shape == (9, 8 + 21)
    assert len(names) == rows.shape[1]
    column = {name: rows[:, k] for k, name in enumerate(names)}
    np.testing.assert_array_equal(column["t"], survey.submaps.time_s)
    np.testing.assert_array_equal(rows[:, 1:4], survey.submaps.after[:, :3, 3])
    covariance = survey.submaps.covariance
    for name, (i, j) in {"x_x": (0, 0), "x_y": (0, 1), "y_y": (1, 1), "yaw_yaw": (2, 2), "yaw_x": (2, 0)}.items():
        np.testing.assert_array_equal(column[f"P_{name}"], covariance[:, i, j])
    known = {f"P_{name}" for name in ("x_x", "x_y", "y_y", "yaw_yaw", "yaw_x", "yaw_y")}
    for name in names[8:]:
        assert np.isnan(column[name]).all() == (name not in known)


def test_submaps_without_times_say_that_t_counts_them(tmp_path: Path):
    survey = corrected_survey.of_submaps()
    rows = written(tmp_path, survey)
    assert rows[:, 0].tolist() == list(range(9))
    assert "t counts the submaps" in (tmp_path / "a.tum").read_text()
