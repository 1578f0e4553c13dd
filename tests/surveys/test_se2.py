"""SE(2): the axioms of a group, and that it acts on the plane."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st
from scipy import linalg

from pointnetkl.surveys import pose
from pointnetkl.surveys.se2 import SE2, rotate

metres, yaws = st.floats(-1e3, 1e3), st.floats(-3.0, 3.0)
motions = st.builds(lambda x, y, yaw: SE2(np.array([x, y]), yaw), metres, metres, yaws)
places = st.builds(lambda x, y: np.array([x, y]), metres, metres)
few = hypothesis_settings(max_examples=50, deadline=None)


def assert_same(a: SE2, b: SE2) -> None:
    assert a.translation == pytest.approx(b.translation, abs=1e-9)
    assert a.yaw == pytest.approx(b.yaw, abs=1e-12)


@few
@given(motions, motions, motions)
def test_the_product_is_associative(a: SE2, b: SE2, c: SE2):
    assert_same((a @ b) @ c, a @ (b @ c))


@few
@given(motions)
def test_the_identity_is_neutral_on_both_sides(a: SE2):
    assert_same(a @ SE2.identity(), a)
    assert_same(SE2.identity() @ a, a)


@few
@given(motions)
def test_a_motion_and_its_inverse_make_the_identity(a: SE2):
    assert_same(a @ a.inverse(), SE2.identity())
    assert_same(a.inverse() @ a, SE2.identity())


@few
@given(motions, motions, places)
def test_a_product_acts_as_its_factors_one_after_the_other(a: SE2, b: SE2, point: np.ndarray):
    assert (a @ b).act(point) == pytest.approx(a.act(b.act(point)), abs=1e-9)
    assert SE2.identity().act(point) == pytest.approx(point)


@few
@given(motions, places, places)
def test_a_motion_keeps_distances(a: SE2, p: np.ndarray, q: np.ndarray):
    assert np.linalg.norm(a.act(p) - a.act(q)) == pytest.approx(np.linalg.norm(p - q), abs=1e-9)


@few
@given(motions)
def test_exp_and_log_undo_each_other(a: SE2):
    assert_same(SE2.exp(a.log()), a)
    assert SE2.exp(a.to_vector()).log() == pytest.approx(a.to_vector(), abs=1e-8)


@few
@given(motions)
def test_exp_is_the_exponential_of_the_matrix_of_the_tangent_vector(a: SE2):
    x, y, yaw = a.to_vector()
    generator = np.array([[0, -yaw, x], [yaw, 0, y], [0, 0, 0]])
    motion = SE2.exp(np.array([x, y, yaw]))
    assert motion.to_matrix()[np.ix_([0, 1, 3], [0, 1, 3])] == pytest.approx(linalg.expm(generator), abs=1e-8)


@few
@given(motions, st.floats(-1.0, 1.0), st.floats(-1.0, 1.0))
def test_motions_along_one_tangent_vector_add_up(a: SE2, s: float, t: float):
    tangent = a.log() / 2
    assert_same(SE2.exp(s * tangent) @ SE2.exp(t * tangent), SE2.exp((s + t) * tangent))


@few
@given(motions, motions)
def test_the_adjoint_takes_tangent_vectors_from_one_frame_to_another(a: SE2, b: SE2):
    # a exp(v) a^-1 = exp(Ad v)
    assert_same(a @ b @ a.inverse(), SE2.exp(a.adjoint() @ b.log()))


@few
@given(motions, motions)
def test_a_quotient_is_the_product_with_the_inverse(a: SE2, b: SE2):
    assert_same(a / b, a @ b.inverse())
    assert_same((a / b) @ b, a)


@few
@given(motions, places)
def test_a_motion_about_a_centre_is_the_motion_between_two_shifts(a: SE2, centre: np.ndarray):
    there = SE2(centre, 0.0)
    assert_same(a.from_centre(centre), there @ a @ there.inverse())


@few
@given(motions, motions)
def test_matrices_multiply_as_the_motions_do(a: SE2, b: SE2):
    assert (a @ b).to_matrix() == pytest.approx(a.to_matrix() @ b.to_matrix(), abs=1e-9)
    assert_same(SE2.from_matrix(a.to_matrix()), a)
    assert a.to_matrix() == pytest.approx(pose.matrix(np.array([*a.translation, 0.0]), float(a.yaw)))


@few
@given(motions, st.floats(-100.0, 100.0))
def test_a_motion_acts_on_poses_and_points_as_its_matrix_does(a: SE2, z: float):
    T = pose.matrix(np.array([3.0, -4.0, z]), 0.7)
    assert a.act_on_pose(T) == pytest.approx(a.to_matrix() @ T, abs=1e-9)
    points = np.array([[1.0, 2.0, z], [-50.0, 30.0, 2.0]])
    assert a.act(points) == pytest.approx(pose.transform(a.to_matrix(), points), abs=1e-9)


def test_many_motions_are_as_good_as_one_after_the_other():
    rng = np.random.default_rng(0)
    a, b = (SE2.from_vector(rng.normal(size=(4, 5, 3))) for _ in range(2))
    points = rng.normal(size=(4, 5, 2))
    for i, j in np.ndindex(4, 5):
        c, d = (SE2(m.translation[i, j], m.yaw[i, j]) for m in (a, b))
        assert np.array_equal((a @ b).to_vector()[i, j], (c @ d).to_vector())
        assert np.array_equal(a.inverse().to_vector()[i, j], c.inverse().to_vector())
        assert np.array_equal(a.log()[i, j], c.log())
        assert np.array_equal(SE2.exp(a.to_vector()).to_vector()[i, j], SE2.exp(c.to_vector()).to_vector())
        assert np.array_equal(a.act(points)[i, j], c.act(points[i, j]))
        assert np.array_equal(a.to_matrix()[i, j], c.to_matrix())


def test_a_motion_without_a_turn_is_its_own_logarithm_to_the_last_bit():
    translations = np.random.default_rng(0).standard_normal((100, 2))
    assert np.array_equal(SE2(translations, np.zeros(100)).log()[:, :2], translations)
    assert np.array_equal(SE2.exp(np.pad(translations, ((0, 0), (0, 1)))).translation, translations)
    assert np.array_equal(rotate(translations, 0.0), translations)
