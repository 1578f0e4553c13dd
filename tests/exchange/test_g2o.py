"""g2o files: what is written comes back, each dialect means what it says, and what is damaged is refused."""

from pathlib import Path

import gtsam
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import graphs
import toy_survey
from pointnetkl.exchange import g2o, graph_exchange
from pointnetkl.exchange.g2o import G2oError, Graph
from pointnetkl.slam.graph import pose_graph

SEEDS = st.integers(0, 2**32 - 1)
VERTICES = "VERTEX_SE3:QUAT 0 0 0 0 0 0 0 1\nVERTEX_SE3:QUAT 1 1 0 0 0 0 0 1\n"
UNIT = " ".join("1" if i == j else "0" for i in range(6) for j in range(i, 6))
EDGE = f"EDGE_SE3:QUAT 0 1 1 0 0 0 0 0 1 {UNIT}\n"


def text(folder: Path, content: str | bytes) -> Path:
    path = folder / "a.g2o"
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return path


def in_file(graph: Graph, dialect: str) -> np.ndarray:
    """Return the numbers (e, 6, 6) of the information as the file has them."""
    lines = [line.split() for line in g2o.to_text(graph, dialect).splitlines() if line.startswith("EDGE")]
    upper = np.array([[float(word) for word in words[10:]] for words in lines])
    full = np.zeros((len(lines), 6, 6))
    full[:, *np.triu_indices(6)] = upper
    return full + np.swapaxes(np.triu(full, 1), 1, 2)


@pytest.mark.parametrize("dialect", g2o.DIALECTS)
@given(seed=SEEDS)
@settings(max_examples=40, deadline=None)
def test_a_graph_with_full_matrices_comes_back(tmp_path_factory: pytest.TempPathFactory, dialect: str, seed: int):
    graph, path = graphs.graph(seed), tmp_path_factory.mktemp("g2o") / "a.g2o"
    g2o.write(path, graph, dialect)
    content = g2o.read(path)
    again = content.graph
    assert (content.dialect, content.is_stated) == (dialect, True)
    for name in ("number", "fixed", "information"):
        np.testing.assert_array_equal(getattr(again, name), getattr(graph, name))
    np.testing.assert_array_equal(again.edges.target, graph.edges.target)
    np.testing.assert_array_equal(again.edges.source, graph.edges.source)
    np.testing.assert_array_equal(again.poses[:, :3, 3], graph.poses[:, :3, 3])
    np.testing.assert_allclose(again.poses, graph.poses, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(again.edges.T_target_source, graph.edges.T_target_source, rtol=1e-12, atol=1e-12)


@given(seed=SEEDS)
@settings(max_examples=20, deadline=None)
def test_the_dialects_differ_by_the_factors_of_half_an_angle_and_by_nothing_else(seed: int):
    graph = graphs.graph(seed)
    halves = np.repeat([1.0, 2.0], 3)
    np.testing.assert_array_equal(in_file(graph, "g2o"), in_file(graph, "gtsam") * np.outer(halves, halves))
    kept = [line for line in g2o.to_text(graph, "g2o").splitlines() if line[0] not in "#E"]
    assert kept == [line for line in g2o.to_text(graph, "gtsam").splitlines() if line[0] not in "#E"]


@given(seed=SEEDS)
@settings(max_examples=20, deadline=None)
def test_g2o_s_own_error_of_a_small_motion_costs_what_the_tangent_vector_does(seed: int):
    graph, rng = graphs.graph(seed, scales=1.0), np.random.default_rng(seed)
    (first,) = graphs.poses(1, rng, 10.0)
    for measured, information, written in zip(
        graph.edges.T_target_source, graph.information, in_file(graph, "g2o"), strict=True
    ):
        measured[:3, 3] /= 1e3  # rounding of kilometres is no small motion
        tangent = 1e-6 * rng.normal(size=6)  # what the two differ by grows with it: up to 12 times its size
        second = first @ measured @ gtsam.Pose3.Expmap(tangent).matrix()
        T = np.linalg.inv(measured) @ np.linalg.inv(first) @ second
        q = gtsam.Rot3(T[:3, :3]).toQuaternion()
        error = np.array([*T[:3, 3], q.x(), q.y(), q.z()]) * np.sign(q.w())
        scale = np.abs(tangent) @ np.abs(information) @ np.abs(tangent)
        assert abs(error @ written @ error - tangent @ information @ tangent) < 1e-4 * scale


@given(seed=SEEDS)
@settings(max_examples=20, deadline=None)
def test_gtsam_reads_its_dialect_as_it_was_meant(tmp_path_factory: pytest.TempPathFactory, seed: int):
    graph, path = graphs.graph(seed), tmp_path_factory.mktemp("g2o") / "a.g2o"
    g2o.write(path, graph, "gtsam")
    factors, values = gtsam.readG2o(str(path), True)
    for k, factor in enumerate(factors.at(i) for i in range(factors.size())):
        ends = graph.number[[graph.edges.target[k], graph.edges.source[k]]]
        assert factor.keys() == ends.tolist()
        np.testing.assert_allclose(factor.measured().matrix(), graph.edges.T_target_source[k], rtol=1e-9, atol=1e-9)
        size = np.sqrt(np.diag(graph.information[k]))
        read = factor.noiseModel().information() / np.outer(size, size)
        np.testing.assert_allclose(read, graph.information[k] / np.outer(size, size), atol=1e-12)
    for name, T in zip(graph.number.tolist(), graph.poses, strict=True):
        np.testing.assert_allclose(values.atPose3(name).matrix(), T, rtol=1e-9, atol=1e-9)


def test_gtsam_s_reader_and_solver_give_the_answer_of_our_pose_graph(tmp_path: Path):
    _, survey = toy_survey.graph()
    edges, noise = survey.closures.edges, survey.dead_reckoning_noise
    q = np.tile([[0.04, 0.03], [0.03, 0.09]], (len(edges.source), 1, 1))
    full = pose_graph.closure_covariances(q, survey.closure_noise)
    dead_reckoning = pose_graph.between(survey.navigation)
    start = pose_graph.chain(survey.gt[0], dead_reckoning)
    ours = pose_graph.PoseGraph(survey.gt[0], edges, full).optimise(dead_reckoning, noise, start)
    g2o.write(
        tmp_path / "toy.g2o",
        graph_exchange.join(survey.number, start, dead_reckoning, noise, edges, full),
        "gtsam",
    )
    factors, values = gtsam.readG2o(str(tmp_path / "toy.g2o"), True)
    factors.add(gtsam.PriorFactorPose3(0, values.atPose3(0), gtsam.noiseModel.Isotropic.Sigma(6, 1e-6)))
    tight = gtsam.LevenbergMarquardtParams()
    tight.setRelativeErrorTol(1e-12)
    solved = gtsam.LevenbergMarquardtOptimizer(factors, values, tight).optimize()
    theirs = np.array([solved.atPose3(node).matrix() for node in range(len(start))])
    assert np.abs(ours - start)[:, :2, 3].max() > 0.05  # there was something to solve
    np.testing.assert_allclose(theirs, ours, atol=1e-5)


def test_a_file_that_does_not_say_its_dialect_is_taken_for_g2o_s_and_said_so(tmp_path: Path):
    path = text(tmp_path, "# by hand\nPARAMS_SE3OFFSET 0 0 0 0 0 0 0 1\n" + EDGE + "\r\nFIX 1 0\n" + VERTICES)
    plain, named = g2o.read(path), g2o.read(path, "gtsam")
    assert (plain.dialect, plain.is_stated, named.dialect, named.is_stated) == ("g2o", False, "gtsam", True)
    assert np.diag(plain.graph.information[0]).tolist() == [0.25, 0.25, 0.25, 1, 1, 1]
    assert np.diag(named.graph.information[0]).tolist() == 6 * [1]
    assert plain.graph.fixed.tolist() == [0, 1]


def test_a_caller_who_contradicts_the_file_is_told(tmp_path: Path):
    g2o.write(tmp_path / "a.g2o", graphs.graph(0), "gtsam")
    with pytest.raises(G2oError, match="its first line says dialect gtsam, not g2o"):
        g2o.read(tmp_path / "a.g2o", "g2o")


def test_a_graph_without_edges_is_one(tmp_path: Path):
    alone = g2o.read(text(tmp_path, VERTICES)).graph
    g2o.write(tmp_path / "b.g2o", alone, "gtsam")
    again = g2o.read(tmp_path / "b.g2o").graph
    assert (again.poses.shape, again.information.shape, again.fixed.shape) == ((2, 4, 4), (0, 6, 6), (0,))


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        ("# pointnetkl pose graph, dialect gtsan: poses\n" + VERTICES, "says dialect 'gtsan'; there are g2o and gtsam"),
        ("", "has no VERTEX_SE3:QUAT"),
        ("# nothing\n", "has no VERTEX_SE3:QUAT"),
        ("VERTEX_SE2 0 0 0 0\n", r"line 1: it begins with 'VERTEX_SE2'; only VERTEX_SE3:QUAT"),
        (VERTICES + "VERTEX_SE3:QUAT 2 1 2 3\n", "line 3: it has 4 words after VERTEX_SE3:QUAT, must have 8"),
        (VERTICES + "FIX\n", "line 3: it has 0 words"),
        (VERTICES + VERTICES, "line 3: vertex 0 stands there a second time"),
        (VERTICES + EDGE.replace("T 0 1", "T 0 7"), "line 3: there is no vertex 7"),
        (VERTICES + EDGE.replace("T 0 1", "T 1 1"), "line 3: an edge joins vertex 1 to itself"),
        (VERTICES + "FIX 9\n", "line 3: there is no vertex 9"),
        (VERTICES.replace("T 1 1", "T 1 nan"), "line 2: 'nan' is not a finite number"),
        (VERTICES.replace("T 1 1", "T 1 1e999"), "line 2: '1e999' is not a finite number"),
        (VERTICES.replace("T 1 1", "T 1 1_0"), "line 2: '1_0' is not a finite number"),
        (VERTICES.replace("T 1 1", "T 1.5 1"), r"line 2: '1.5' is not a whole number from 0"),
        (VERTICES.replace("T 1 1", "T -1 1"), "line 2: '-1' is not a whole number"),
        (VERTICES.replace("T 1 1", f"T {'9' * 30} 1"), "line 2: '999999999999999999999999999999' is not a whole"),
        (VERTICES.replace("0 0 0 1\n", "0 0 0 2\n"), "line 1: its quaternion has not length 1"),
        (VERTICES.replace("0 0 0 1\n", "0 0 0 0\n"), "line 1: its quaternion has not length 1"),
        (VERTICES + EDGE.replace("1 0 0 0 0 0 1 0", "1 0 0 0 0 0 -1 0"), "line 3: its .* is not positive definite"),
        (VERTICES + EDGE.replace("1 1 0 0 0 0 0 1 1 0", "1 1 0 0 0 0 0 1 1 2"), "line 3: its information is not"),
        (VERTICES + EDGE.replace(" 1 0 0 0 0 0 1 0", " 0 0 0 0 0 0 1 0"), "line 3: its information is not"),
        (b"\x1f\x8b\x08\x00 packed", "line 1: it is no text"),
    ],
)
def test_what_is_no_graph_is_refused_by_its_line(tmp_path: Path, content: str | bytes, sentence: str):
    with pytest.raises(G2oError, match=sentence) as refused:
        g2o.read(text(tmp_path, content))
    assert str(refused.value).startswith(str(tmp_path / "a.g2o"))
    assert "\n" not in str(refused.value)


def test_a_missing_file_is_named(tmp_path: Path):
    with pytest.raises(G2oError, match=r"gone\.g2o: cannot be read \(No such file"):
        g2o.read(tmp_path / "gone.g2o")


def test_a_damaged_file_is_a_graph_or_an_error_of_ours(tmp_path: Path):
    whole, rng = g2o.to_text(graphs.graph(0), "g2o").encode(), np.random.default_rng(0)
    refused = 0
    for _ in range(400):
        path = text(tmp_path, graphs.mutated(whole, rng))
        try:
            graph = g2o.read(path).graph
        except G2oError as error:
            sentence, refused = str(error), refused + 1
            graphs.assert_one_sentence(sentence, path)
        else:
            assert np.isfinite(graph.poses).all()
            assert (
                np.linalg.eigvalsh(graph.information) > -1e-6 * np.abs(graph.information).max((1, 2))[:, None]
            ).all()
    assert 200 < refused < 400
