"""Truths of the method mean_field: the physics alone, as a way to get Q like any other."""

import dataclasses

import numpy as np
import pytest

import terrains
import toy_submaps
from pointnetkl.methods.closed_forms.mean_field import MeanField
from pointnetkl.models import mean_field
from pointnetkl.models.mean_field import MeanFieldError
from pointnetkl.registration import monte_carlo
from pointnetkl.registration.covariance import gaussian, method, table
from pointnetkl.surveys.submap import Submap

LABEL = dataclasses.replace(toy_submaps.LABEL, noise_sigma_m=0.2)
ALONE = MeanField(LABEL, toy_submaps.REGISTRATION)
WITH_YAW = MeanField(LABEL, toy_submaps.WITH_YAW)


def test_it_is_the_descriptions_covariance():
    submap = toy_submaps.submap("mild")
    conditions = mean_field.conditions(LABEL, toy_submaps.REGISTRATION)
    np.testing.assert_array_equal(ALONE.covariance(submap), mean_field.describe(submap.points, conditions).covariance)


@pytest.mark.parametrize("kind", ["flat", "gentle", "mild", "rugged"])
def test_with_yaw_it_is_near_what_monte_carlo_finds(kind: str):
    submap, rng = toy_submaps.submap(kind), np.random.default_rng(1)
    label = monte_carlo.covariance(monte_carlo.errors(submap, 200, rng, LABEL, toy_submaps.WITH_YAW).errors)
    p, q = (gaussian.with_floor(matrix, 0.01) for matrix in (label, WITH_YAW.covariance(submap)))
    # flat ground: the pull of nearest points finds more of the yaw than is said
    assert gaussian.kl_divergence(p, q) < (1.0 if kind == "flat" else 0.1)


def test_yaw_stands_apart_from_the_same_x_and_y():
    submap = toy_submaps.submap("gentle")
    q = WITH_YAW.covariance(submap)
    np.testing.assert_array_equal(q[:2, :2], ALONE.covariance(submap))
    np.testing.assert_array_equal(q[2, :2], 0)


@pytest.mark.parametrize("method", [ALONE, WITH_YAW])
def test_it_turns_with_the_submap(method: MeanField):
    toy_submaps.assert_turns(method, "gentle", 0.7, share=0.1)


def test_its_table_has_a_row_a_submap():
    submaps = [toy_submaps.submap("mild", number) for number in range(3)]
    rows = method.tabulate([ALONE], submaps)
    assert rows["method"].unique().tolist() == ["mean_field"]
    np.testing.assert_array_equal(table.to_matrices(rows), [ALONE.covariance(submap) for submap in submaps])


def test_a_submap_without_ground_is_named():
    points = terrains.cloud("mild", 900) * [1, 0, 1]
    with pytest.raises(MeanFieldError, match=r"^toy, submap 7: .* on a line"):
        ALONE.covariance(Submap("toy", 7, points, points, points))
