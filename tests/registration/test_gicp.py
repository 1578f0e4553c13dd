"""GICP in the plane: against the plain reference, against Open3D, and what must hold of any registration."""

import dataclasses

import numpy as np
import pytest
from scipy.spatial import cKDTree

import terrains
from pointnetkl.registration import gicp, reference
from pointnetkl.registration.gicp import kernel, registration
from pointnetkl.surveys.se2 import SE2, rotate

SETTINGS = gicp.Settings(neighbours=20, plane_epsilon=1e-3, max_distance_m=20.0, tolerance_m=1e-3, max_iterations=50)
FINE = dataclasses.replace(SETTINGS, tolerance_m=1e-6, max_iterations=200)
EVERY_KIND = [*terrains.AMPLITUDES_M, "ridge"]


NOISE = gicp.Noise(sigma_m=0.1, key=3)


def moves(count: int) -> np.ndarray:
    return 3 * np.random.default_rng(3).standard_normal((count, 2))


def with_yaw(settings: gicp.Settings) -> gicp.Settings:
    return dataclasses.replace(settings, dof="xyyaw")


@pytest.mark.parametrize("kind", EVERY_KIND)
def test_the_kernel_agrees_with_the_reference_within_a_millimetre(kind: str) -> None:
    cloud = gicp.prepare(terrains.cloud(kind, 400), FINE)
    translations = gicp.register_noisy(cloud, cloud, moves(100), NOISE, FINE).T_target_copy.translation
    target = reference.Cloud(cloud.points, reference.normals(cloud.points, cloud.lists))
    expected = []
    for move, noise in zip(moves(100), NOISE.draw(100, len(cloud.points)), strict=True):
        moved = cloud.points + np.append(move, 0) + noise
        copy = reference.Cloud(moved, reference.normals(moved, cloud.lists))
        expected.append(reference.register(copy, target, FINE)[0].translation)
    difference = np.linalg.norm(translations - np.stack(expected), axis=1)
    assert np.mean(difference < 1e-3) >= 0.99


@pytest.mark.parametrize("kind", EVERY_KIND)
def test_information_is_that_of_the_reference(kind: str) -> None:
    source, target = (gicp.prepare(terrains.cloud(kind, 400, p), FINE) for p in (1, 2))
    ours = gicp.register(source, target, FINE, SE2(np.array([1.0, -1.0]), 0.0))
    moved = source.points + np.array([1.0, -1.0, 0.0])
    normals = [reference.normals(c.points, c.lists) for c in (source, target)]
    T_target_moved, information, _ = reference.register(
        reference.Cloud(moved, normals[0]), reference.Cloud(target.points, normals[1]), FINE
    )
    assert np.allclose(ours.T_target_source.translation, T_target_moved.translation + np.array([1.0, -1.0]), atol=1e-4)
    assert np.allclose(ours.information, information, rtol=1e-3, atol=1e-3 * information.max())


def test_normals_are_those_of_the_reference_and_point_up() -> None:
    cloud = gicp.prepare(terrains.cloud("rugged", 2000), SETTINGS)
    expected = reference.normals(cloud.points, cloud.lists)
    assert (cloud.normals[:, 2] >= 0).all()
    assert np.allclose(np.abs(np.sum(cloud.normals * expected, axis=1)), 1, atol=1e-5)


@pytest.mark.parametrize("dof", ["xy", "xyyaw"])
@pytest.mark.parametrize("kind", EVERY_KIND)
def test_matches_that_are_kept_are_still_the_nearest_after_every_iteration(kind: str, dof: str) -> None:
    settings = dataclasses.replace(SETTINGS, dof=dof, max_distance_m=5.0)
    target, source = (gicp.prepare(terrains.cloud(kind, 1000, seed), settings) for seed in (1, 2))
    tree = cKDTree((target.points - target.centre).astype(np.float32))
    T = SE2.identity()
    for iterations in range(1, 30):
        copy, T_after = aligned(source, target, dataclasses.replace(settings, max_iterations=iterations))
        # the matches of an iteration are those of the motion after the one before
        moved = T.act(np.column_stack([copy.x, copy.y, copy.z]).astype(np.float64))
        nearest, _ = tree.query(moved)
        distance = np.linalg.norm(tree.data[copy.matches] - moved, axis=1)
        matched = copy.matches >= 0
        assert distance[matched] == pytest.approx(nearest[matched], abs=1e-4)
        assert nearest[~matched] == pytest.approx(np.maximum(nearest[~matched], 5.0), abs=1e-4)
        T = T_after


def aligned(source: gicp.Cloud, target: gicp.Cloud, settings: gicp.Settings) -> tuple[kernel.Copy, SE2]:
    """Return what the kernel keeps of a source 2 m off the target when its iterations are over, and the motion."""
    points, n = source.as_source(target, np.array([2.0, -1.0, 0.0])), len(source.points)
    copy = kernel.allocate(n)
    copy.x[:], copy.y[:], copy.z[:] = points.points
    copy.normals[: 3 * n] = points.normals
    motion, *_ = kernel.align(copy, target.as_target, 0.0, registration.limits(settings))
    return copy, SE2.from_vector(np.array(motion))


@pytest.mark.parametrize("kind", ["mild", "rugged"])
def test_a_cloud_moved_over_itself_is_moved_back(kind: str) -> None:
    points = terrains.cloud(kind, 2000)
    target = gicp.prepare(points, SETTINGS)
    result = gicp.register(gicp.prepare(points + np.array([2.0, -1.5, 0.0]), SETTINGS), target, SETTINGS)
    assert result.converged
    assert result.matched_share == 1
    assert np.allclose(result.T_target_source.translation, [-2.0, 1.5], atol=1e-3)


def test_another_pass_over_rugged_ground_is_found_within_centimetres_wherever_the_map_lies() -> None:
    for origin in ([0.0, 0.0, 0.0], [650_000.0, 6_400_000.0, -350.0]):
        target = gicp.prepare(terrains.cloud("rugged", 4000, 1) + origin, SETTINGS)
        source = gicp.prepare(terrains.cloud("rugged", 2000, 2, 60.0) + origin + [31.0, 20.0, 0.0], SETTINGS)
        result = gicp.register(source, target, SETTINGS, SE2(np.array([-30.0, -21.0]), 0.0))
        assert result.converged
        assert np.allclose(result.T_target_source.translation, [-31.0, -20.0], atol=0.1)


def test_open3d_finds_the_same_translation_on_rugged_ground() -> None:
    o3d = pytest.importorskip("open3d")
    target = terrains.cloud("rugged", 2000, 1)
    source = terrains.cloud("rugged", 2000, 2) + np.array([1.0, 0.7, 0.0])
    clouds = [o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points)) for points in (source, target)]
    theirs = o3d.pipelines.registration.registration_generalized_icp(*clouds, 20.0).transformation[:2, 3]
    ours = gicp.register(*(gicp.prepare(points, SETTINGS) for points in (source, target)), SETTINGS)
    assert np.allclose(ours.T_target_source.translation, theirs, atol=0.05)


@pytest.mark.parametrize("kind", EVERY_KIND)
def test_the_kernel_with_yaw_agrees_with_the_reference_within_a_millimetre_and_a_hundred_thousandth(kind: str) -> None:
    cloud = gicp.prepare(terrains.cloud(kind, 400), FINE)
    results = gicp.register_noisy(cloud, cloud, moves(50), NOISE, with_yaw(FINE))
    points = cloud.points - cloud.centre
    target = reference.Cloud(points, reference.normals(points, cloud.lists))
    expected = []
    for move, noise in zip(moves(50), NOISE.draw(50, len(points)), strict=True):
        moved = points + np.append(move, 0) + noise
        copy = reference.Cloud(moved, reference.normals(moved, cloud.lists))
        expected.append(reference.register(copy, target, with_yaw(FINE))[0])
    difference = np.abs(results.T_target_copy.to_vector() - np.stack([T.to_vector() for T in expected]))
    assert np.mean((difference < [1e-3, 1e-3, 1e-5]).all(axis=1)) >= 0.97


def test_a_cloud_turned_over_itself_is_turned_back() -> None:
    points = terrains.cloud("rugged", 2000) + np.array([50.0, -20.0, 0.0])
    target = gicp.prepare(points, SETTINGS)
    c, s = np.cos(0.02), np.sin(0.02)
    turned = (points - target.centre) @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]) + target.centre + [1.0, -0.5, 0.0]
    result = gicp.register(gicp.prepare(turned, SETTINGS), target, with_yaw(SETTINGS))
    assert result.converged
    assert np.isclose(result.T_target_source.yaw, -0.02, atol=1e-5)
    # it is turned about the target's centre first, with its own centre at (1, -0.5), then translated
    assert np.allclose(result.T_target_source.translation, -np.array([[c, s], [-s, c]]) @ [1.0, -0.5], atol=1e-3)


def test_with_yaw_the_translation_across_a_ridge_stays_small() -> None:
    cloud = gicp.prepare(terrains.cloud("ridge", 2000), SETTINGS)
    without_yaw, yaw_too = (
        gicp.register_noisy(cloud, cloud, moves(100), NOISE, s) for s in (SETTINGS, with_yaw(SETTINGS))
    )
    assert np.array_equal(without_yaw.T_target_copy.yaw, np.zeros(100))
    assert 1e-6 < np.asarray(yaw_too.T_target_copy.yaw).std() < 1e-2
    assert (yaw_too.T_target_copy.translation + moves(100))[:, 1].std() < 0.1  # across the ridge


def test_a_start_with_yaw_reaches_a_large_turn() -> None:
    points = terrains.cloud("rugged", 2000) + np.array([50.0, -20.0, 0.0])
    target = gicp.prepare(points, SETTINGS)
    yaw, translation = 2.0, np.array([4.0, -2.0])  # too far to be found from where the cloud is
    xy = rotate(points[:, :2] - target.centre[:2] - translation, -yaw) + target.centre[:2]
    source = gicp.prepare(np.column_stack([xy, points[:, 2]]), SETTINGS)
    result = gicp.register(source, target, with_yaw(SETTINGS), SE2(np.array([3.5, -1.7]), 1.99))
    assert result.T_target_source.yaw == pytest.approx(yaw, abs=1e-4)
    assert result.T_target_source.translation == pytest.approx(translation, abs=1e-2)
    assert abs(gicp.register(source, target, with_yaw(SETTINGS)).T_target_source.yaw - yaw) > 0.1
    noisy = gicp.register_noisy(source, target, np.array([[0.0, 0.0, 1.99]]), NOISE, with_yaw(SETTINGS))
    assert noisy.T_target_copy.yaw == pytest.approx([yaw], abs=1e-2)


def test_information_with_yaw_is_that_of_the_cost_about_the_solution() -> None:
    target = gicp.prepare(terrains.cloud("rugged", 400), FINE)
    result = gicp.register(target, target, with_yaw(FINE))
    solution = gicp.linearise(
        target.points, target.normals.astype(float), target, result.T_target_source, with_yaw(FINE)
    )
    assert result.information == pytest.approx(solution.information, rel=1e-4)
    assert result.information[:2, :2] == pytest.approx(gicp.register(target, target, FINE).information, rel=1e-6)


def test_a_start_with_a_yaw_needs_the_dof() -> None:
    cloud = gicp.prepare(terrains.cloud("mild", 300), SETTINGS)
    with pytest.raises(gicp.GicpError, match="needs the dof xyyaw"):
        gicp.register(cloud, cloud, SETTINGS, SE2(np.zeros(2), 0.1))
    with pytest.raises(gicp.GicpError, match="have a yaw"):
        gicp.register_noisy(cloud, cloud, np.zeros((1, 3)), NOISE, SETTINGS)


def test_a_registration_without_matches_returns_its_start() -> None:
    cloud = gicp.prepare(terrains.cloud("mild", 300), SETTINGS)
    for start in ((500.0, 3.0), (5e7, 0.0)):
        result = gicp.register(cloud, cloud, SETTINGS, SE2(np.array(start), 0.0))
        assert not result.converged
        assert result.matched_share == 0
        assert np.array_equal(result.T_target_source.translation, start)
        assert np.array_equal(result.information, np.zeros((2, 2)))


def test_a_partial_overlap_is_enough() -> None:
    target = gicp.prepare(terrains.cloud("rugged", 3000, 1), SETTINGS)
    beyond = terrains.cloud("rugged", 6000, 2, 180.0)
    source = gicp.prepare(beyond[beyond[:, 0] > 10], SETTINGS)
    settings = dataclasses.replace(SETTINGS, max_distance_m=3.0)
    result = gicp.register(source, target, settings, SE2(np.array([1.0, 0.5]), 0.0))
    assert 0.2 < result.matched_share < 0.9
    assert np.linalg.norm(result.T_target_source.translation) < 0.1


def test_duplicates_walls_lines_and_outliers_neither_hang_nor_break_a_registration() -> None:
    rng = np.random.default_rng(0)
    ground = terrains.cloud("mild", 500)
    wall = np.column_stack([np.zeros(500), rng.uniform(-20, 20, 500), rng.uniform(-300, 0, 500)])
    line = np.column_stack([np.linspace(0, 4000, 1000), np.zeros(1000), np.zeros(1000)])
    clouds = [np.repeat(ground, 30, axis=0), wall, line, np.vstack([ground, [[9e4, -9e4, 0]]]), np.ones((50, 3))]
    for points in (*clouds, ground[:3]):
        cloud = gicp.prepare(points, SETTINGS)
        result = gicp.register(cloud, cloud, SETTINGS, SE2(np.array([0.3, 0.2]), 0.0))
        assert np.isfinite(cloud.normals).all()
        assert np.isfinite(result.T_target_source.translation).all()
        assert (np.linalg.eigvalsh(result.information) > 0).all()


@pytest.mark.parametrize(
    ("points", "why"),
    [
        (np.zeros((2, 3)), "3 or more points"),
        (np.zeros((5, 2)), "3 or more points"),
        (np.full((5, 3), np.nan), "not finite"),
        (np.diag([2e5, 0, 0]), "200000 m"),
    ],
)
def test_a_cloud_that_cannot_be_registered_is_refused_with_the_reason(points: np.ndarray, why: str) -> None:
    with pytest.raises(gicp.GicpError, match=why):
        gicp.prepare(points, SETTINGS)


@pytest.mark.parametrize(
    "change",
    [{"neighbours": 2}, {"plane_epsilon": 0.0}, {"max_distance_m": -1.0}, {"max_iterations": 0}, {"dof": "yaw"}],
)
def test_settings_that_make_no_sense_are_refused(change: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=next(iter(change))):
        dataclasses.replace(SETTINGS, **change)  # type: ignore[arg-type]
