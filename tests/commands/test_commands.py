"""The commands that take pose graphs in and out: a survey's graph exported, a user's solved, submaps made one."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import cKDTree

import toy_graphs
import toy_models
import toy_survey
from pointnetkl import __main__ as command
from pointnetkl.commands import NAMES
from pointnetkl.exchange import g2o, posed_submaps, tum
from pointnetkl.exchange.posed_submaps import PosedSubmapsError
from pointnetkl.readers.formats import clouds as cloud_files
from pointnetkl.readers.formats.clouds import CloudFileError
from pointnetkl.registration.covariance import table
from pointnetkl.slam.benchmark import protocol
from pointnetkl.slam.graph import pose_graph, survey_graph
from pointnetkl.surveys import pose, submap
from pointnetkl.workflow import artifacts
from pointnetkl.workflow import parameters as parameters
from realdata import REALDATA

PARAMS = Path(__file__).parents[2] / "params.yaml"
Q = np.array([[0.04, 0.03], [0.03, 0.09]])
TILT = 0.05  # radians, of the toy submaps' files


@pytest.fixture(scope="module")
def survey(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a small survey's graph.npz, q.parquet and poses.parquet."""
    folder = tmp_path_factory.mktemp("survey")
    _, graph = toy_survey.graph()
    artifacts.write_arrays(folder / "graph.npz", survey_graph.to_arrays(graph), {})
    count = len(graph.number)
    rows = table.from_matrices("toy", "network", graph.number, np.tile(Q, (count, 1, 1)))
    artifacts.write_table(folder / "q.parquet", rows, table.SCHEMA, {})
    x, y, z = graph.navigation[:, :3, 3].T
    poses = rows[["submap"]].assign(time_s=1e9 + 10.0 * np.arange(count), x_m=x, y_m=y, z_m=z, yaw_rad=0.0)
    poses = poses.assign(track_m=30.0, pings=9, soundings=500, line=0)
    poses = poses.astype({"pings": np.int32, "line": np.int32, "soundings": np.int32})
    artifacts.write_table(folder / "poses.parquet", poses, submap.POSES, {})
    artifacts.write_table(folder / "other_poses.parquet", poses, submap.POSES, {"survey": "other"})
    artifacts.write_table(folder / "other_q.parquet", rows.assign(survey="other"), table.SCHEMA, {})
    return folder


def run(capsys: pytest.CaptureFixture, *words: object) -> tuple[int, str, str]:
    """Return a command's exit status and what it printed."""
    capsys.readouterr()
    status = command.main(list(map(str, words)))
    out, err = capsys.readouterr()
    return status, out, err


def export(survey: Path, out: Path, *more: object) -> list[object]:
    words = ["--covariances", survey / "q.parquet", "--params", PARAMS, "--out", out]
    return ["export", survey / "graph.npz", *words, *more]


@pytest.mark.slow
@pytest.mark.parametrize("dialect", g2o.DIALECTS)
def test_an_exported_graph_solves_to_what_the_benchmark_finds(
    survey: Path, tmp_path: Path, dialect: str, capsys: pytest.CaptureFixture
):
    words = export(survey, tmp_path / "a.g2o", "--dialect", dialect, "--corrupted", 2, "--edges", "shared")
    status, out, _ = run(capsys, *words)
    assert (status, out.split()[:2]) == (0, ["toy:", "12"])
    status, out, _ = run(capsys, "solve", tmp_path / "a.g2o", "--out", tmp_path / "b.g2o", "--tum", tmp_path / "b.tum")
    assert (status, f"dialect {dialect}\n" in out) == (0, True)

    graph = survey_graph.from_arrays(artifacts.read_arrays(survey / "graph.npz")[0])
    settings = parameters.read(PARAMS, "slam", protocol.Settings)
    q = dict.fromkeys(graph.number.tolist(), Q + settings.floor_m2 * np.eye(2))
    full = survey_graph.full_covariances(graph.number, q, graph.closures, graph.closure_noise, "toy", "shared")
    dead_reckoning = protocol.corrupt(graph, 0, 2, settings)
    start = pose_graph.chain(graph.gt[0], dead_reckoning)
    factors = pose_graph.PoseGraph(graph.gt[0], graph.closures.edges, full)
    expected = factors.optimise(dead_reckoning, graph.dead_reckoning_noise, start)
    np.testing.assert_allclose(g2o.read(tmp_path / "b.g2o").graph.poses, expected, atol=1e-4)
    times, poses = tum.read(tmp_path / "b.tum")
    np.testing.assert_allclose(poses, expected, atol=1e-4)
    np.testing.assert_array_equal(times, graph.number)
    assert np.abs(expected - start)[:, :2, 3].max() > 0.1


def test_an_export_has_the_poses_of_gt_and_their_times(survey: Path, tmp_path: Path, capsys: pytest.CaptureFixture):
    words = ["--tum", tmp_path / "a.tum", "--poses", survey / "poses.parquet"]
    assert run(capsys, *export(survey, tmp_path / "a.g2o", *words))[0] == 0
    graph = survey_graph.from_arrays(artifacts.read_arrays(survey / "graph.npz")[0])
    times, poses = tum.read(tmp_path / "a.tum")
    np.testing.assert_allclose(poses, graph.gt, atol=1e-12)
    np.testing.assert_array_equal(times, 1e9 + 10.0 * np.arange(12))


def test_solving_with_our_covariances_says_what_it_replaced(
    survey: Path, tmp_path: Path, capsys: pytest.CaptureFixture
):
    run(capsys, *export(survey, tmp_path / "a.g2o", "--edges", "all"))
    words = ["--covariances", survey / "q.parquet", "--out", tmp_path / "b.g2o"]
    status, out, _ = run(capsys, "solve", tmp_path / "a.g2o", *words)
    graph = g2o.read(tmp_path / "b.g2o").graph
    count = len(graph.edges.source) - 11
    assert status == 0
    assert f"covariance in the plane of {count} loop closures, by network" in out
    covariance = np.linalg.inv(graph.information[11:])[:, 3:5, 3:5]
    np.testing.assert_allclose(covariance, np.tile(Q, (count, 1, 1)), rtol=1e-6)


def test_an_assumed_dialect_is_told(survey: Path, tmp_path: Path, capsys: pytest.CaptureFixture):
    run(capsys, *export(survey, tmp_path / "a.g2o"))
    bare = "".join((tmp_path / "a.g2o").read_text().splitlines(keepends=True)[1:])
    (tmp_path / "a.g2o").write_text(bare)
    _, out, _ = run(capsys, "solve", tmp_path / "a.g2o", "--out", tmp_path / "b.g2o")
    assert "dialect g2o, which the file does not say: --dialect names another" in out
    _, out, _ = run(capsys, "solve", tmp_path / "a.g2o", "--dialect", "gtsam", "--out", tmp_path / "b.g2o")
    assert "dialect gtsam\n" in out


def test_a_robust_solver_names_the_loop_closures_that_it_does_not_believe(
    tmp_path: Path, capsys: pytest.CaptureFixture
):
    graph, wrong = toy_graphs.mesh()
    g2o.write(tmp_path / "a.g2o", graph, "g2o")
    words = ["--out", tmp_path / "b.g2o", "--params", PARAMS, "--robust", "gnc"]
    status, out, _ = run(capsys, "solve", tmp_path / "a.g2o", *words)
    ends = (graph.number[nodes[wrong]] for nodes in (graph.edges.target, graph.edges.source))
    assert status == 0
    assert "gnc: 1 of 22 loop closures not accepted: {}-{}".format(*ends) in out


@pytest.mark.parametrize(
    ("replaced", "sentence"),
    [
        (["--method", "laser"], "has no method laser, but network"),
        (["--corrupted", -1], "--corrupted is -1, must be 0 or above"),
        (["--params", "gone.yaml"], "gone.yaml: cannot be read"),
        (["--covariances", "gone.parquet"], "gone.parquet: is missing"),
        (["--tum", "OUT"], "two files are to be written there"),
        (["--covariances", "OTHER_q"], "has covariances of survey other, not of toy"),
        (["--poses", "OTHER_poses"], "is of survey other, not of toy"),
    ],
)
def test_what_cannot_be_exported_is_told_in_a_sentence(
    survey: Path, tmp_path: Path, replaced: list[object], sentence: str, capsys: pytest.CaptureFixture
):
    files = {"OUT": tmp_path / "a.g2o"} | {f"OTHER_{name}": survey / f"other_{name}.parquet" for name in ("q", "poses")}
    more = [files.get(str(word), word) for word in replaced]
    status, out, err = run(capsys, *export(survey, tmp_path / "a.g2o", *more))
    assert (status, out, err.count("\n")) == (1, "", 1)
    assert sentence in err
    assert not (tmp_path / "a.g2o").exists()


def test_a_damaged_graph_ends_solve_in_a_sentence(tmp_path: Path, capsys: pytest.CaptureFixture):
    (tmp_path / "a.g2o").write_text("VERTEX_SE2 0 0 0 0\n")
    status, out, err = run(capsys, "solve", tmp_path / "a.g2o", "--out", tmp_path / "b.g2o")
    assert (status, out, err.count("\n")) == (1, "", 1)
    assert err.startswith(f"error: {tmp_path / 'a.g2o'}: line 1: it begins with 'VERTEX_SE2'")
    assert not (tmp_path / "b.g2o").exists()


def test_one_file_is_not_written_over_another(survey: Path, tmp_path: Path, capsys: pytest.CaptureFixture):
    run(capsys, *export(survey, tmp_path / "a.g2o"))
    out = tmp_path / "b.g2o"
    status, _, err = run(capsys, "solve", tmp_path / "a.g2o", "--out", out, "--tum", tmp_path / "." / "b.g2o")
    assert (status, err) == (1, f"error: {out}: two files are to be written there; give each a name of its own\n")
    assert not out.exists()


def test_a_damaged_graph_of_the_pipeline_ends_export_in_a_sentence(
    survey: Path, tmp_path: Path, capsys: pytest.CaptureFixture
):
    arrays, _ = artifacts.read_arrays(survey / "graph.npz")
    artifacts.write_arrays(tmp_path / "graph.npz", arrays | {"gt": arrays["gt"] * np.nan}, {})
    words = ["--covariances", survey / "q.parquet", "--params", PARAMS, "--out", tmp_path / "a.g2o"]
    status, _, err = run(capsys, "export", tmp_path / "graph.npz", *words)
    assert (status, "graph.npz: the graph is damaged: gt has a number that is not finite" in err) == (1, True)


def test_every_command_has_help_that_says_what_it_takes(capsys: pytest.CaptureFixture):
    words = {"slam": "VIEWPOINT", "export": "dialect", "solve": "|i - j| > 1", "predict": "PCD"}
    for name in NAMES:
        with pytest.raises(SystemExit) as ended:
            command.main([name, "--help"])
        assert ended.value.code == 0
        out = capsys.readouterr().out
        assert words.get(name, "") in out
        assert max(map(len, out.splitlines())) <= 120


def pcd(path: Path, points: np.ndarray, T: np.ndarray | None) -> Path:
    """Write a PCD file of points in the frame whose pose T is."""
    lines = "".join(f"{x:.5f} {y:.5f} {z:.5f}\n" for x, y, z in points)
    viewpoint = ""
    if T is not None:
        x, y, z, w = pose.quaternions(T[None])[0]
        viewpoint = "VIEWPOINT " + " ".join(f"{v:.9g}" for v in [*T[:3, 3], w, x, y, z]) + "\n"
    head = "VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\n"
    path.write_text(f"{head}WIDTH {len(points)}\nHEIGHT 1\n{viewpoint}POINTS {len(points)}\nDATA ascii\n{lines}")
    return path


def tilted(roll: float) -> np.ndarray:
    T = np.eye(4)
    T[1:3, 1:3] = [[np.cos(roll), -np.sin(roll)], [np.sin(roll), np.cos(roll)]]
    return T


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> tuple[list[Path], np.ndarray]:
    """Return six PCD files of tilted submaps on two lines, and the true poses; those in the files drift."""
    folder, (submaps, truth) = tmp_path_factory.mktemp("pcd"), toy_survey.sail(2, 3)
    drifting = truth.copy()
    drifting[:, :2, 3] += 0.4 * np.arange(6)[:, None] * [0.8, -0.6]
    paths = []
    for k, toy in enumerate(submaps):
        tilt = tilted(TILT * (-1) ** k)
        points = pose.transform(np.linalg.inv(tilt), toy.points)
        paths.append(pcd(folder / f"submap_{k}.pdc", points, drifting[k] @ tilt))
    return paths, truth


@pytest.mark.slow
def test_submaps_in_files_become_an_optimised_graph(
    files: tuple[list[Path], np.ndarray], tmp_path: Path, capsys: pytest.CaptureFixture
):
    paths, truth = files
    model = toy_models.write(tmp_path, "mean_field")
    status, out, err = run(capsys, "slam", model, *paths, "--out", tmp_path / "o", "--params", PARAMS)
    assert status == 0, err
    head, *rows = out.splitlines()
    assert head.split() == ["file", "points", "closures", "moved_m", "major_m", "minor_m", "novelty", "far"]
    closures = [int(row.split()[2]) for row in rows[:6]]
    assert (closures[:3], min(closures[4:]) > 0) == ([0, 0, 0], True)
    graph = g2o.read(tmp_path / "o/graph.g2o").graph
    assert len(graph.edges.source) == 5 + sum(closures)
    times, poses = tum.read(tmp_path / "o/trajectory.tum")
    np.testing.assert_array_equal(times, np.arange(6))
    np.testing.assert_allclose(poses, graph.poses, atol=1e-12)
    _, drifting = posed_submaps.read(paths)
    before, after = (apart(p) - apart(truth) for p in (drifting, poses))
    assert np.linalg.norm(before) > 1.9
    assert np.linalg.norm(after) < 0.2


def apart(poses: np.ndarray) -> np.ndarray:
    """Return where the last submap is to the first, which it overlaps."""
    return (np.linalg.inv(poses[0]) @ poses[5])[:2, 3]


def test_roll_and_pitch_go_from_the_pose_into_the_points(files: tuple[list[Path], np.ndarray]):
    submaps, poses = posed_submaps.read(files[0])
    expected, _ = toy_survey.sail(2, 3)
    for levelled, T, toy in zip(submaps, poses, expected, strict=True):
        np.testing.assert_allclose(levelled.points, toy.points, atol=1e-4)
        np.testing.assert_allclose(T[2], [0, 0, 1, -20], atol=1e-7)


def test_spacing_is_the_side_of_the_square_of_one_point():
    submaps, _ = toy_survey.sail(1, 2)
    side = np.sqrt(toy_survey.LENGTH * toy_survey.SWATH / toy_survey.POINTS)
    assert posed_submaps.spacing(submaps) == pytest.approx(side, rel=0.15)


def test_more_coverage_than_there_is_closes_no_loop_and_is_warned_of(
    files: tuple[list[Path], np.ndarray], tmp_path: Path, capsys: pytest.CaptureFixture
):
    model = toy_models.write(tmp_path, "mean_field")
    words = ["--out", tmp_path / "o", "--params", PARAMS, "--coverage"]
    status, out, err = run(capsys, "slam", model, *files[0], *words, 1)
    assert (status, "loop closures: 0;" in out) == (0, True)
    assert "warning: no submap returns to ground of which earlier ones cover 1" in err
    assert run(capsys, "slam", model, *files[0], *words, 7)[2].startswith("error: --coverage is 7")


def test_a_model_with_yaw_needs_registrations_that_find_it(
    files: tuple[list[Path], np.ndarray], tmp_path: Path, capsys: pytest.CaptureFixture
):
    model = toy_models.write(tmp_path, "mean_field", dimensions=3)
    status, _, err = run(capsys, "slam", model, *files[0], "--out", tmp_path / "o", "--params", PARAMS)
    assert (status, "is a model of 3 dimensions, and registration.dof in" in err) == (1, True)


def test_files_without_poses_are_refused_in_a_sentence(tmp_path: Path):
    points = np.random.default_rng(0).normal(size=(50, 3))
    np.savez(tmp_path / "a.npz", points=points)
    with pytest.raises(CloudFileError, match=r"a\.npz: holds no pose; write the submap as PCD with its pose"):
        cloud_files.read_posed(tmp_path / "a.npz")
    with pytest.raises(CloudFileError, match=r"b\.pcd: holds no pose"):
        cloud_files.read_posed(pcd(tmp_path / "b.pcd", points, None))
    same = [pcd(tmp_path / f"{name}.pcd", points, np.eye(4)) for name in "cd"]
    with pytest.raises(PosedSubmapsError, match="are at one place: their VIEWPOINT says no pose"):
        posed_submaps.read(same)
    with pytest.raises(PosedSubmapsError, match="there is 1 submap"):
        posed_submaps.read(same[:1])


@pytest.mark.parametrize(
    ("viewpoint", "sentence"),
    [
        ("1 2 3 1 1 0 0", "has not length 1"),
        ("1 2 nan 1 0 0 0", "VIEWPOINT is no pose: 'nan' is not a finite number"),
        ("1 2 3", "VIEWPOINT has 3 numbers, must have 7: x y z qw qx qy qz"),
    ],
)
def test_a_viewpoint_that_is_no_pose_is_refused(tmp_path: Path, viewpoint: str, sentence: str):
    path = pcd(tmp_path / "a.pcd", np.zeros((3, 3)), np.eye(4))
    path.write_text(path.read_text().replace("VIEWPOINT 0 0 0 1 0 0 0", f"VIEWPOINT {viewpoint}"))
    with pytest.raises(CloudFileError, match=sentence) as refused:
        cloud_files.read_posed(path)
    assert str(refused.value).startswith(f"{path}: ")


@pytest.mark.skipif(not REALDATA.exists(), reason="the real files are not here")
def test_the_authors_toy_submaps_become_an_optimised_graph(tmp_path: Path, capsys: pytest.CaptureFixture):
    paths = sorted((REALDATA / "pcd").glob("*.pdc"))
    model = toy_models.write(tmp_path, "mean_field")
    words = ["--out", tmp_path / "o", "--params", PARAMS, "--coverage", 0.15]
    status, out, err = run(capsys, "slam", model, *paths, *words)
    assert (status, "9 submaps" in out, "registrations: 1, loop closures: 2;" in out) == (0, True, True), err
    content = g2o.read(tmp_path / "o/graph.g2o").graph
    assert (len(content.number), len(content.edges.source)) == (9, 10)
    submaps, before_poses = posed_submaps.read(paths)
    # 6 and 3 were not registered to each other: that the others were brings their heights together
    clouds = [[pose.transform(poses[k], submaps[k].points) for k in (3, 6)] for poses in (before_poses, content.poses)]
    before, after = (heights_apart(*pair) for pair in clouds)
    assert after < 0.9 * before < 0.2


def heights_apart(ground: np.ndarray, points: np.ndarray) -> float:
    """Return the rms difference in height of points to ground that lies below or above them."""
    distance, nearest = cKDTree(ground[:, :2]).query(points[:, :2])
    near = distance < 0.4
    return float(np.sqrt(np.mean((points[near, 2] - ground[nearest[near], 2]) ** 2)))


def test_the_help_names_every_command(capsys: pytest.CaptureFixture):
    with pytest.raises(SystemExit) as ended:
        command.main(["--help"])
    out = capsys.readouterr().out
    assert (ended.value.code, [name for name in NAMES if name not in out]) == (0, [])
