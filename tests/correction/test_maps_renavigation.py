import numpy as np
import pytest

import corrected_soundings
import corrected_survey
from pointnetkl.correction import maps
from pointnetkl.correction.result import CorrectionError

SURVEY = corrected_survey.corrected()
SOUNDINGS = corrected_soundings.swaths(SURVEY.track)
BEFORE = SOUNDINGS[["x_m", "y_m"]].to_numpy()


def test_a_track_shifted_three_metres_east_moves_every_sounding_three_metres_east() -> None:
    track = corrected_soundings.moved_by(SURVEY, x=3.0).track
    assert np.array_equal(maps.renavigated(SOUNDINGS, track), BEFORE + np.array([3.0, 0.0]))


def test_a_turn_of_a_ping_turns_its_soundings_about_it() -> None:
    track = corrected_soundings.moved_by(SURVEY, yaw=np.pi / 2).track
    pings = track[["x_m", "y_m"]].to_numpy()[SOUNDINGS["ping"]]
    offset = BEFORE - pings
    turned = pings + np.column_stack([-offset[:, 1], offset[:, 0]])
    np.testing.assert_allclose(maps.renavigated(SOUNDINGS, track), turned, atol=1e-9)


def test_a_sounding_keeps_its_place_in_the_frame_of_its_ping() -> None:
    after = maps.renavigated(SOUNDINGS, SURVEY.track)
    pose, moved = corrected_survey.after(SURVEY.track), SURVEY.track[["x_m", "y_m", "yaw_rad"]].to_numpy()
    one, other = (_in_ping(places, poses[SOUNDINGS["ping"]]) for places, poses in ((BEFORE, moved), (after, pose)))
    np.testing.assert_allclose(one, other, atol=1e-9)


def test_pings_need_not_be_numbered_from_zero() -> None:
    track = SURVEY.track.assign(ping=7 + 3 * SURVEY.track["ping"])
    renumbered = SOUNDINGS.assign(ping=7 + 3 * SOUNDINGS["ping"])
    assert np.array_equal(maps.renavigated(renumbered, track), maps.renavigated(SOUNDINGS, SURVEY.track))


def test_points_without_pings_do_not_move() -> None:
    points = SOUNDINGS.assign(ping=-1)
    track = corrected_soundings.without_pings(SURVEY).track
    assert np.array_equal(maps.renavigated(points, track), BEFORE)


@pytest.mark.parametrize("ping", [-1, 200, 100_000])
def test_a_sounding_of_a_ping_that_the_track_lacks_is_refused(ping: int) -> None:
    track = SURVEY.track[SURVEY.track["ping"] != 200]
    with pytest.raises(CorrectionError, match=f"lacks ping {ping}"):
        maps.renavigated(SOUNDINGS[:3].assign(ping=ping), track)


def _in_ping(places: np.ndarray, pose: np.ndarray) -> np.ndarray:
    east, north = (places - pose[:, :2]).T
    cos, sin = np.cos(pose[:, 2]), np.sin(pose[:, 2])
    return np.column_stack([cos * east + sin * north, -sin * east + cos * north])
