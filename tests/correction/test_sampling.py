"""Submap length and point spacing chosen from the data: they follow the swath, and not the noise."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import raw_survey
import whole_survey
from pointnetkl.correction.preparation import sampling
from pointnetkl.correction.preparation.sampling import Sampling
from raw_survey import Plan

PLAN = Plan(lines=2, seabed=raw_survey.flat)


def tables(folder: Path, plan: Plan) -> tuple[pd.DataFrame, pd.DataFrame]:
    whole = whole_survey.read(raw_survey.write(folder, plan).folder)
    return whole.pings, whole.soundings


def chosen(folder: Path, plan: Plan, longest_m: float = np.inf) -> Sampling:
    pings, soundings = tables(folder, plan)
    return sampling.choose(pings, [soundings], longest_m)


@pytest.fixture(scope="module")
def usual(tmp_path_factory: pytest.TempPathFactory) -> Sampling:
    return chosen(tmp_path_factory.mktemp("usual"), PLAN)


@pytest.mark.parametrize("factor", [0.1, 10.0, 100.0])
def test_length_and_spacing_scale_with_the_survey(tmp_path: Path, usual: Sampling, factor: float):
    larger = replace(
        PLAN, line_m=factor * PLAN.line_m, step_m=factor * PLAN.step_m, swath_m=factor * PLAN.swath_m, apart_m=0.0
    )
    found = chosen(tmp_path, larger)
    for name in ("length_m", "spacing_m", "max_gap_m"):
        assert getattr(found, name) == pytest.approx(factor * getattr(usual, name), rel=0.06)


def test_a_wide_dense_swath_is_cut_into_squares_of_some_thousand_points(tmp_path: Path):
    found = chosen(tmp_path, replace(PLAN, swath_m=200.0, beams=160, step_m=1.0))
    assert found.length_m == pytest.approx(200.0, rel=0.05)
    assert 3000 < found.length_m * 200.0 / found.spacing_m**2 < 5000


def test_points_are_no_closer_than_pings_and_beams(tmp_path: Path, usual: Sampling):
    assert usual.spacing_m >= 2.0
    assert chosen(tmp_path, replace(PLAN, beams=12)).spacing_m >= PLAN.swath_m / 12


def test_a_submap_is_no_longer_than_a_fifth_of_the_longest_line(tmp_path: Path):
    assert chosen(tmp_path, PLAN, 360.0).length_m == pytest.approx(72.0)


def test_a_dual_head_survey_is_cut_like_the_single_head_one(tmp_path: Path, usual: Sampling):
    pings, soundings = tables(tmp_path, replace(PLAN, heads=2))
    assert len(pings) == 2 * pings["time_s"].nunique()
    found = sampling.choose(pings, [soundings], np.inf)
    for name in ("length_m", "spacing_m", "max_gap_m"):
        assert getattr(found, name) == pytest.approx(getattr(usual, name), rel=0.05)


@pytest.mark.parametrize(("step_m", "jitter_m"), [(2.0, 0.3), (0.5, 0.3), (2.0, 0.6)])
def test_noise_in_positions_hardly_changes_it(tmp_path: Path, step_m: float, jitter_m: float):
    quiet, noisy = (
        chosen(tmp_path / name, replace(PLAN, step_m=step_m, jitter_m=noise, swath_m=120.0))
        for name, noise in (("quiet", 0.0), ("noisy", jitter_m))
    )
    assert noisy.spacing_m == pytest.approx(quiet.spacing_m, rel=0.15)
    assert noisy.length_m == pytest.approx(quiet.length_m, rel=0.3)
    assert quiet.max_gap_m <= noisy.max_gap_m < 2.5 * quiet.max_gap_m


def test_a_vehicle_at_anchor_for_half_of_the_time_does_not_change_it(tmp_path: Path, usual: Sampling):
    pings, soundings = tables(tmp_path, PLAN)
    waiting = pings.iloc[[0] * len(pings)].assign(ping=np.arange(len(pings)) + len(pings))
    found = sampling.choose(pd.concat([waiting, pings], ignore_index=True), [soundings], np.inf)
    assert (found.length_m, found.spacing_m) == (usual.length_m, usual.spacing_m)


def test_pings_in_pairs_are_one_line(tmp_path: Path):
    # dual swath: two pings nearly at one place, then a step; the gap must be above that step
    pings, soundings = tables(tmp_path, replace(PLAN, swath_m=40.0))
    x = pings["x_m"].to_numpy().reshape(2, -1)[:, :-1].copy()
    x[:, 1::2] = x[:, ::2] + 0.02
    pings = pings.groupby("file").head(x.shape[1]).assign(x_m=x.ravel())
    assert np.median(np.abs(np.diff(x))) < 1  # most steps are short
    assert sampling.choose(pings, [soundings], np.inf).max_gap_m > 2 * (2 * PLAN.step_m - 0.02) / 2


def test_bad_soundings_do_not_count(tmp_path: Path, usual: Sampling):
    pings, soundings = tables(tmp_path, PLAN)
    far = soundings.assign(x_m=soundings["x_m"] + 1e4 * (soundings["beam"] % 3 - 1), beam=999, quality=np.int8(1))
    found = sampling.choose(pings, [pd.concat([soundings, far], ignore_index=True)], np.inf)
    assert (found.length_m, found.spacing_m) == (usual.length_m, usual.spacing_m)


@pytest.mark.parametrize("part", ["no soundings", "one place", "nowhere", "few beams"])
def test_a_swath_that_cannot_be_measured_gives_a_sampling_all_the_same(tmp_path: Path, part: str):
    pings, soundings = tables(tmp_path, PLAN)
    parts = {
        "no soundings": [],
        "one place": [soundings.assign(x_m=0.0, y_m=0.0)],
        "nowhere": [soundings.assign(x_m=np.where(soundings["beam"] == 3, np.nan, soundings["x_m"]))],
        "few beams": [soundings[soundings["beam"] < 3]],
    }
    found = sampling.choose(pings, parts[part], np.inf)
    assert np.isfinite([found.length_m, found.spacing_m, found.max_gap_m]).all()
    assert min(found.length_m, found.spacing_m, found.max_gap_m) > 0


def test_a_single_ping_gives_a_sampling_all_the_same(tmp_path: Path):
    pings, soundings = tables(tmp_path, PLAN)
    found = sampling.choose(pings[:1], [soundings[soundings["ping"] == 0]], 0.0)
    assert min(found.length_m, found.spacing_m, found.max_gap_m) > 0


def test_the_reason_has_the_numbers(usual: Sampling):
    assert "78.4 m wide" in usual.reason
    assert f"every {usual.spacing_m:g} m" in usual.reason
