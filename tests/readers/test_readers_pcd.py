"""PCD: a submap has the pose in its file, a cloud without a pose is a surface, and no count is trusted."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from damage import corrupted
from pcd_files import CLOUD, FORMS, POSE, write
from pointnetkl.readers import projection
from pointnetkl.readers.formats import clouds, lzf, pcd, recording
from pointnetkl.readers.formats.pcd import PcdError
from pointnetkl.readers.formats.recording import Recording
from pointnetkl.surveys.survey import POINTS, SUBMAPS
from realdata import REALDATA

TOYS = sorted((REALDATA / "pcd").glob("*.pdc"))
each_form = pytest.mark.parametrize("form", FORMS)


def placed(part: Recording) -> np.ndarray:
    """Return the soundings (n, 3) of a submap on the map, as a survey's chain places them."""
    (ping,), table = part.pings.to_dict("records"), part.soundings
    sin, cos = np.sin(ping["heading_rad"]), np.cos(ping["heading_rad"])
    east = ping["east"] + table["along_m"] * sin + table["across_m"] * cos
    north = ping["north"] + table["along_m"] * cos - table["across_m"] * sin
    return np.column_stack([east, north, -(ping["depth_m"] + table["down_m"])])


@each_form
def test_a_submap_is_a_ping_without_a_time_whose_points_lie_where_its_pose_has_them(tmp_path: Path, form: str):
    (part,) = pcd.read(write(tmp_path / "a.pcd", form))
    assert (part.kind, part.crs, len(part.pings)) == (SUBMAPS, projection.LOCAL, 1)
    assert list(part.pings) == list(recording.PING_COLUMNS)
    assert set(part.soundings) == set(recording.SOUNDING_COLUMNS)
    assert np.isnan(part.pings["time_s"][0])
    assert part.pings["depth_m"][0] == -4.625
    turn = Rotation.from_quat([0.0, 0.28, 0.0, 0.96])
    np.testing.assert_allclose(placed(part), turn.apply(CLOUD) + np.array([11.5, -45.25, 4.625]), atol=1e-4)


def test_along_is_where_the_pose_looks_and_starboard_is_to_its_right(tmp_path: Path):
    head = "VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 2\nHEIGHT 1\n"
    north = "VIEWPOINT 0 0 -5 0.70710678 0 0 0.70710678\n"
    (tmp_path / "a.pcd").write_text(head + north + "POINTS 2\nDATA ascii\n10 0 -20\n0 3 -20\n")
    (part,) = pcd.read(tmp_path / "a.pcd")
    np.testing.assert_allclose(part.pings[["depth_m", "heading_rad"]], [[5, 0]], atol=1e-7)
    expected = [[10, 0, 20], [0, -3, 20]]
    np.testing.assert_allclose(part.soundings[["along_m", "across_m", "down_m"]], expected, atol=1e-6)
    np.testing.assert_allclose(placed(part), [[0, 10, -25], [-3, 0, -25]], atol=1e-5)


@each_form
def test_a_cloud_without_a_pose_is_a_surface(tmp_path: Path, form: str):
    (part,) = pcd.read(write(tmp_path / "a.pcd", form, "0 0 0 1 0 0 0"))
    assert (part.kind, len(part.pings)) == (POINTS, 0)
    np.testing.assert_allclose(part.soundings[["east", "north", "up_m"]], CLOUD, atol=1e-4)


@pytest.mark.skipif(not TOYS, reason="no real data here")
@pytest.mark.parametrize("path", TOYS, ids=lambda path: path.stem)
def test_the_authors_toy_submaps_lie_where_their_poses_have_them(path: Path):
    (part,) = pcd.read(path)
    points, T = clouds.read_posed(path)
    assert len(part.soundings) == len(points) > 4100
    np.testing.assert_allclose(placed(part), points @ T[:3, :3].T + T[:3, 3], atol=1e-9)
    assert not part.problems


@pytest.mark.parametrize("form", ["ascii", "binary"])
@pytest.mark.parametrize("pose", [POSE, "0 0 0 1 0 0 0"])
def test_a_file_that_is_cut_gives_the_points_that_it_has(tmp_path: Path, form: str, pose: str):
    path = write(tmp_path / "a.pcd", form, pose)
    path.write_bytes(path.read_bytes()[:-2000])
    (part,) = pcd.read(path)
    assert 150 < len(part.soundings) < 350
    assert "its header says 400 points, it has" in part.problems[0]


def test_points_that_are_not_numbers_are_counted(tmp_path: Path):
    path = write(tmp_path / "a.pcd", "ascii")
    lines = path.read_text().splitlines()
    lines[20:23] = ["nan nan nan", "1 2", "7 8 nine"]
    path.write_text("\n".join(lines))
    (part,) = pcd.read(path)
    assert len(part.soundings) == 397
    assert part.skipped == {"lines that are not numbers": 2, "points that are not finite": 1}


@pytest.mark.parametrize(
    ("old", "new", "cause"),
    [
        ("POINTS 400", "POINTS 4000000000", "do not fit"),
        ("POINTS 400", "POINTS -4", "do not fit|says -4"),
        ("SIZE 4 4 4", "SIZE 4 4 9", "the header of its PCD is damaged"),
        ("COUNT 1 1 1", "COUNT 1 1 9", "must be one number each"),
        ("FIELDS x y z", "FIELDS x y w", "its points have no z"),
        ("DATA binary_compressed", "DATA of any sort\n", "is not known|without a line DATA"),
        ("0.96", "0.5", "has not length 1"),
    ],
)
def test_a_head_that_is_not_true_is_refused_in_a_sentence(tmp_path: Path, old: str, new: str, cause: str):
    path = write(tmp_path / "a.pcd", "compressed")
    path.write_bytes(path.read_bytes().replace(old.encode(), new.encode()))
    with pytest.raises(PcdError, match=cause) as caught:
        list(pcd.read(path))
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)


@each_form
def test_mutated_files_end_in_a_sentence_or_in_finite_points(tmp_path: Path, form: str):
    content = write(tmp_path / "a.pcd", form).read_bytes()
    rng = np.random.default_rng(8)
    for _ in range(150):
        (tmp_path / "a.pcd").write_bytes(corrupted(content, rng))
        try:
            parts = list(pcd.read(tmp_path / "a.pcd"))
        except PcdError as error:
            sentence = str(error)
            assert "\n" not in sentence
        else:
            assert all(np.isfinite(part.soundings.to_numpy(float)).all() for part in parts)


def test_a_copy_within_compressed_bytes_may_reach_into_itself():
    assert lzf.decompress(b"\x01ab\xe0\x02\x01", 13) == b"abababababab" + b"a"
    for damaged in (b"\x01ab\xe0\x02\x07", b"\x01ab\xe0", b"\x05ab"):
        with pytest.raises(ValueError, match="compressed"):
            lzf.decompress(damaged, 13)


def test_a_file_is_recognised_by_its_first_word():
    assert pcd.begins(b"# .PCD v0.7\nVERSION 0.7\n")
    assert pcd.begins(b"FIELDS x y z\n")
    assert not pcd.begins(b"1 2 3\nVERSION")
    assert not pcd.begins(b"")
