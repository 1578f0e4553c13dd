"""Submaps with ellipses: the right ones, the right way round, to scale; a seabed whose light comes from one side."""

import dataclasses

import numpy as np
import pandas as pd
import pytest

from pointnetkl.reporting import results
from pointnetkl.reporting.covariances import cases, ellipse_plots
from pointnetkl.reporting.drawing import plots, relief

RNG = np.random.default_rng(0)
GRID = np.mgrid[-20:20:1.5, -50:50:1.5].reshape(2, -1).T + RNG.uniform(0, 1, (27 * 67, 2))


def cloud(slope: float) -> np.ndarray:
    """Return a seabed of waves across the track, points (n, 3) in metres, as steep as asked."""
    return np.column_stack([GRID, 10 * slope * np.sin(GRID[:, 1] / 10)])


def survey(name: str, q: np.ndarray, methods: dict[str, np.ndarray]) -> cases.Survey:
    """Return a survey with labels q (k, M, M) and other methods' covariances; submaps are numbered from 100."""
    k = len(q)
    labels = results.Labels(100 + np.arange(k), q, np.full(k, 1.5), np.zeros(k, bool), pd.DataFrame(), {})
    nothing = np.empty((0, 2))
    test = results.Test(
        methods, np.empty((k, 0, 2)), pd.DataFrame(), pd.DataFrame(), nothing, nothing, nothing, nothing
    )
    return cases.Survey(name, [cloud(0.1 * i) for i in range(k)], labels, test, 0.01)


def scaled(*factors: float) -> np.ndarray:
    """Return covariances (k, 2, 2): factors times one that is longest across the track."""
    return np.array(factors)[:, None, None] * np.array([[0.25, 0.1], [0.1, 1.0]])


@pytest.fixture
def two() -> list[cases.Survey]:
    """Two surveys of a few submaps, with a network that is wrong about some of them."""
    first = survey("borno_8", scaled(1, 4, 0.01, 1e-4), {"network": scaled(1, 4, 0.5, 1e-4)})
    return [first, survey("mine", scaled(2, 9), {"network": scaled(2, 0.01), "constant": scaled(3, 3)})]


def test_submaps_are_chosen_from_the_largest_label_to_the_smallest(two: list[cases.Survey]):
    chosen = cases.large_to_small(two[0], ["network", "cello"], 3)
    assert [case.submap for case in chosen] == [101, 102, 103]
    assert list(chosen[0].covariances) == ["network"]
    assert len(cases.large_to_small(two[1], ["network"], 4)) == 2


def test_the_worst_submaps_of_all_surveys_come_worst_first(two: list[cases.Survey]):
    found = cases.worst(two, "network", 2)
    assert [(case.survey, case.submap) for case in found] == [("mine", 101), ("borno_8", 102)]
    assert found[0].kl["network"] > found[1].kl["network"] > 0
    assert [case.survey for case in cases.worst(two, "constant", 5)] == ["mine", "mine"]


def test_the_best_submaps_of_all_surveys_come_best_first(two: list[cases.Survey]):
    chosen = cases.best(two, "network", 6)
    divergences = [case.kl["network"] for case in chosen]
    assert divergences == sorted(divergences)
    assert chosen[-1].kl["network"] == cases.worst(two, "network", 1)[0].kl["network"]


def test_an_ellipse_holds_95_percent_and_turns_with_the_track_upward():
    q = np.array([[9.0, 2.0], [2.0, 1.0]])  # longest along the track, turned to port
    starboard, along = ellipse_plots.boundary(q)
    farthest = np.argmax(along)
    assert along[farthest] == pytest.approx(3 * 2.4477, rel=1e-3)
    assert starboard[farthest] < 0
    port = np.stack([along, -starboard])
    np.testing.assert_allclose(np.einsum("ik,ij,jk->k", port, np.linalg.inv(q), port), 5.991, rtol=1e-3)


def test_yaw_is_written_and_does_not_change_the_ellipse():
    q = np.diag([9.0, 1.0, np.radians(2.0) ** 2])
    assert ellipse_plots.sigmas(q) == "3 × 1 m, 2°"
    assert ellipse_plots.sigmas(q[:2, :2]) == "3 × 1 m"
    np.testing.assert_array_equal(ellipse_plots.boundary(q), ellipse_plots.boundary(q[:2, :2]))


def outlines(figure: plots.Figure) -> list[np.ndarray]:
    """Return the corners of the ellipses on a page, inches from its middle."""
    polygons = [p.get_xy() for p in figure.axes[0].patches if not p.get_fill() and len(p.get_xy()) > 10]
    return [corners - corners.mean(axis=0) for corners in polygons]


def test_ellipses_of_one_submap_have_one_scale(two: list[cases.Survey]):
    case = two[1].case(0, ["constant"])
    label, constant = outlines(ellipse_plots.worst("constant", [case]))
    assert np.ptp(constant, axis=0) == pytest.approx(np.ptp(label, axis=0) * np.sqrt(3 / 2))


def test_an_ellipse_too_small_to_see_is_a_dot(two: list[cases.Survey]):
    case = dataclasses.replace(two[1].case(0, ["constant"]), label=scaled(1e-6)[0])
    dots = [line for line in ellipse_plots.worst("constant", [case]).axes[0].lines if line.get_marker() == "o"]
    assert len(dots) == 1


def test_what_is_too_large_for_a_gallery_is_said_to_be_beyond(two: list[cases.Survey]):
    case = dataclasses.replace(two[1].case(0, ["network", "constant"]), label=scaled(0.01)[0])
    page = ellipse_plots.gallery({"mine": [case]}).axes[0]
    assert sum("beyond" in text.get_text() for text in page.texts) == 2


def test_pages_are_small_and_the_same_bytes_twice(two: list[cases.Survey]):
    for draw in (
        lambda: ellipse_plots.worst("network", cases.worst(two, "network", 10)),
        lambda: ellipse_plots.gallery({each.name: cases.large_to_small(each, ["network"], 4) for each in two}),
    ):
        first = plots.png(draw())
        assert first == plots.png(draw())
        assert len(first) < 300_000


def test_a_relief_has_no_holes_and_its_forms_are_where_they_are():
    found = relief.from_points(cloud(0.3))
    assert (found.rgba[3:-3, 3:-3, 3] == 255).all()
    assert found.extent[0] == pytest.approx(-50, abs=2)
    assert found.extent[3] == pytest.approx(21, abs=2)
    assert np.ptp(found.depths_m) == pytest.approx(6, abs=0.5)


def test_a_slope_that_faces_the_light_is_brighter_and_level_ground_between():
    starboard = -GRID[:, 1]
    bright, level, dark = (
        relief.from_points(np.column_stack([GRID, tilt * starboard])).rgba[10:-10, 20:-20, :3].mean()
        for tilt in (0.05, 0, -0.05)
    )
    assert bright > level > dark


def test_flat_ground_looks_flat():
    flat, rugged = (relief.from_points(cloud(slope)).rgba[3:-3, 3:-3, 0].astype(float).std() for slope in (0.001, 0.3))
    assert flat < 0.1 * rugged
