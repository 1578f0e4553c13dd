"""Clouds of other programs: every format gives the same points, and no point that is not in the file."""

from pathlib import Path

import numpy as np
import open3d
import pytest

from pointnetkl.readers.formats import clouds
from pointnetkl.readers.formats.clouds import CloudFileError
from realdata import REALDATA

POINTS = np.random.default_rng(0).normal(size=(50, 3)).round(4) * [40, 40, 2]
COLOURED = np.dtype([("normal", "<f4", 3), ("x", "<f8"), ("y", "<f8"), ("rgb", "<u4"), ("z", "<f8")])


def by_open3d(folder: Path, name: str, **options: bool) -> Path:
    cloud = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(POINTS))
    open3d.io.write_point_cloud(str(folder / name), cloud, **options)
    return folder / name


def by_numpy(folder: Path, name: str, content: bytes | str) -> Path:
    (folder / name).write_bytes(content.encode() if isinstance(content, str) else content)
    return folder / name


def coloured_pcd(folder: Path) -> Path:
    rows = np.zeros(50, COLOURED)
    rows["x"], rows["y"], rows["z"], rows["rgb"] = *POINTS.T, 7
    header = (
        "# .PCD v0.7\nVERSION 0.7\nFIELDS normal x y rgb z\nSIZE 4 8 8 4 8\nTYPE F F F U F\nCOUNT 3 1 1 1 1\n"
        "WIDTH 50\nHEIGHT 1\nVIEWPOINT 9 9 9 1 0 0 0\nPOINTS 50\nDATA binary\n"
    )
    return by_numpy(folder, "coloured.pcd", header.encode() + rows.tobytes())


def big_endian_ply(folder: Path) -> Path:
    header = "ply\nformat binary_big_endian 1.0\ncomment element face 3\nelement vertex 50\n"
    header += "property double x\nproperty double y\nproperty double z\nelement face 1\nproperty list uchar int v\n"
    return by_numpy(folder, "big.ply", (header + "end_header\n").encode() + POINTS.astype(">f8").tobytes() + b"\0")


def table(separator: str, head: str = "") -> str:
    return head + "".join(separator.join(f"{v:.6f}" for v in [*p, 9]) + "\n" for p in POINTS)


@pytest.mark.parametrize(
    "write",
    [
        lambda f: by_open3d(f, "a.pcd", write_ascii=True),
        lambda f: by_open3d(f, "b.pcd"),
        lambda f: by_open3d(f, "c.pcd", compressed=True),
        lambda f: by_open3d(f, "a.ply", write_ascii=True),
        lambda f: by_open3d(f, "b.ply"),
        coloured_pcd,
        big_endian_ply,
        lambda f: by_numpy(f, "blanks.xyz", table("  ", "# x y z quality\n\n")),
        lambda f: by_numpy(f, "commas.csv", table(",", "x,y,z,quality\r\n")),
        lambda f: by_numpy(f, "tabs.txt", table("\t", "//X Y Z Q\n")),
    ],
)
def test_every_form_gives_the_same_points_and_not_by_its_name(tmp_path: Path, write):
    path = write(tmp_path)
    renamed = path.rename(tmp_path / "submap.0001")
    points = clouds.read(renamed)
    assert points.dtype == np.float64
    np.testing.assert_allclose(points, POINTS, atol=1e-5)


def test_an_archive_s_array_is_read(tmp_path: Path):
    np.savez(tmp_path / "s.npz", points=POINTS.astype(np.float32), more=np.arange(3))
    np.testing.assert_allclose(clouds.read(tmp_path / "s.npz"), POINTS, atol=1e-5)
    np.savez(tmp_path / "other.npz", cloud=POINTS)
    with pytest.raises(CloudFileError, match="has no array `points`, but cloud"):
        clouds.read(tmp_path / "other.npz")


@pytest.mark.parametrize("form", ["a.pcd", "b.pcd", "c.pcd", "a.ply", "b.ply", "s.npz"])
def test_a_cut_file_is_refused_at_any_length(tmp_path: Path, form: str):
    if form == "s.npz":
        np.savez(tmp_path / form, points=POINTS)
    else:
        by_open3d(tmp_path, form, write_ascii=form[0] == "a", compressed=form[0] == "c")
    content = (tmp_path / form).read_bytes()
    for share in (0.0, 0.02, 0.1, 0.5, 0.95):
        (tmp_path / form).write_bytes(content[: int(share * len(content))])
        with pytest.raises(CloudFileError, match=form) as caught:
            clouds.read(tmp_path / form)
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        ("", "holds no points"),
        ("# nothing\n", "holds no points"),
        ("1 2 3\n4 5\n", "is damaged, or no PCD"),
        ("1,2,3\n4,,6\n", "is damaged, or no PCD"),
        ("1,5 2,5 3,5\n", "is damaged, or no PCD"),
        (b"\x89PNG\r\n\x1a\n\x00\xff", "is damaged, or no PCD"),
        ("VERSION 0.7\nFIELDS x y\nSIZE 4 4\nTYPE F F\nPOINTS 1\nDATA ascii\n1 2\n", "have no z"),
        ("VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nPOINTS 4000000000\nDATA binary\nabc", "0 of 4000000000"),
        ("VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nPOINTS -1\nDATA binary\nabc", "is damaged"),
        ("VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nPOINTS -5\nDATA ascii\n" + 9 * "1 2 3\n", "has -5 points"),
        ("VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nPOINTS -5\nDATA binary\n" + 60 * " ", "has -5 points"),
        ("easting_m (UTM32),northing_m (UTM32),depth\n1,2,3\n", "its columns are easting_m, northing_m, depth; name"),
        ("id lat2 lon2\n1 2 3\n", "its columns are id, lat2, lon2; name"),
        ("x,y,z\n", "holds no points"),
        ("ply\nformat ascii 1.0\nelement face 1\nproperty int a\nend_header\n1\n", "first element is not `vertex`"),
    ],
)
def test_what_is_no_cloud_is_refused_in_a_sentence(tmp_path: Path, content: bytes | str, sentence: str):
    path = by_numpy(tmp_path, "odd.xyz", content)
    with pytest.raises(CloudFileError, match=sentence) as caught:
        clouds.read(path)
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "head",
    ["id,x,y,z", "z,y,x,id", "Y_m,Z_m,id 2,X_m", "z id y x", "x [m] y [m] z [m] id", '"x (UTM32)","z","y","id"'],
)
def test_named_columns_are_taken_whatever_their_order(tmp_path: Path, head: str):
    names = {"x": "1.5", "y": "2.5", "z": "-3.5"}
    separator = "," if "," in head else " "
    bare = head.lower().replace(" [m]", "").replace(" (utm32)", "").replace('"', "").replace("_m", "")
    row = separator.join(names.get(name, "7") for name in bare.split(separator))
    path = by_numpy(tmp_path, "named.csv", f"{head}\n{row}\n{row}\n")
    np.testing.assert_array_equal(clouds.read(path), 2 * [[1.5, 2.5, -3.5]])


def test_a_bare_array_is_asked_for_as_an_archive(tmp_path: Path):
    np.save(tmp_path / "s.npy", POINTS)
    with pytest.raises(CloudFileError, match=r"s\.npy: is an \.npy file; write an \.npz with an array `points`"):
        clouds.read(tmp_path / "s.npy")


def test_a_missing_file_is_named(tmp_path: Path):
    with pytest.raises(CloudFileError, match=r"gone\.pcd: cannot be read \(No such file"):
        clouds.read(tmp_path / "gone.pcd")


@pytest.mark.skipif(not REALDATA.exists(), reason="the real files are not here")
def test_the_authors_toy_submaps_are_read():
    points = clouds.read(REALDATA / "pcd/submap_0_frame.pdc")
    assert points.shape == (4154, 3)
    np.testing.assert_allclose(points[0], [-2.1886084, -19.553972, -8.5146751])
