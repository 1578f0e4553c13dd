"""How a survey is corrected, and how its navigation drifts: what may be asked for, and what is refused."""

import dataclasses
import math
import re
from pathlib import Path

import pytest

from pointnetkl.correction import settings as module
from pointnetkl.correction.result import CorrectionError
from pointnetkl.correction.settings import NAVIGATION, Settings
from pointnetkl.slam.closing import drift
from pointnetkl.workflow import parameters
from pointnetkl.workflow.errors import PointNetKLError

RATES = [field.name for field in dataclasses.fields(drift.Settings)]
PARAMS = Path(__file__).parents[2] / "params.yaml"


def rates(words: str, navigation: str = "", **stated: drift.Settings) -> drift.Settings:
    return module.rates(Settings(drift=words, navigation=navigation), stated)


@pytest.mark.parametrize("name", RATES)
def test_every_rate_can_be_given_by_its_name(name: str):
    assert getattr(rates(f"{name}=0.25"), name) == 0.25


@pytest.mark.parametrize("name", [name for name in RATES if name.endswith("_rad")])
def test_angles_can_be_given_in_degrees(name: str):
    assert getattr(rates(f"{name.removesuffix('_rad')}_deg=0.25"), name) == pytest.approx(math.radians(0.25))


@pytest.mark.parametrize("number", ["0.004", ".004", "4e-3", "+4E-3", "0.0040"])
def test_numbers_can_be_written_as_python_writes_them(number: str):
    assert rates(f" scale_error = {number} ").scale_error == 0.004


def test_several_rates_change_those_of_the_navigation_s_preset_and_no_others():
    usbl = rates("position_walk_m=7,scale_error=0.001", "usbl")
    assert usbl == dataclasses.replace(drift.PRESETS["usbl"], position_walk_m=7.0, scale_error=0.001)


@pytest.mark.parametrize("navigation", ["", *NAVIGATION])
def test_without_rates_they_are_the_navigation_s_preset(navigation: str):
    assert rates("", navigation) == drift.PRESETS[NAVIGATION[navigation or "dead-reckoning"]]


@pytest.mark.parametrize("name", drift.PRESETS)
def test_a_preset_can_be_named(name: str):
    assert rates(name) == drift.PRESETS[name]


def test_a_name_of_the_parameters_comes_before_that_of_a_preset():
    mine = drift.PRESETS["usbl"].times(2)
    assert rates("mine", mine=mine) == mine
    assert rates("gnss", gnss=mine) == mine


@pytest.mark.parametrize(
    "words",
    [
        "gyrocompas",
        " ",
        "scale_error",
        "=",
        "=3",
        "scale_error=",
        "scale_error=much",
        "scale_error=0.1,",
        "scale_error=0.1;heading_bias_deg=1",
        "scale_error==0.1",
        "scale=0.1",
        "SCALE_ERROR=0.1",
        "scale_error_deg=0.1",
        "heading_correlation_deg=1",
        "scale_error=1.1",
        "scale_error=-0.1",
        "scale_error=nan",
        "scale_error=inf",
        "heading_bias_deg=58",
        "velocity_walk_mps=11",
        "position_walk_m=1e5",
        "position_noise_m=0",
        "yaw_noise_rad=-1",
        "heading_correlation_s=0",
        "heading_correlation_s=inf",
        "velocity_correlation_s=1e-310",
        "position_correlation_s=nan",
    ],
)
def test_what_is_no_rate_or_out_of_range_is_one_sentence(words: str):
    with pytest.raises(PointNetKLError, match=r"^drift") as ended:
        rates(words)
    assert "\n" not in str(ended.value)


@pytest.mark.parametrize("words", ["scale=0.1", "scale_error=much", "=3"])
def test_the_sentence_names_what_was_written_and_what_could_be(words: str):
    with pytest.raises(CorrectionError, match=re.escape(repr(words))) as ended:
        rates(words)
    assert all(name in str(ended.value) for name in RATES)


@pytest.mark.parametrize("name", drift.PRESETS)
def test_rates_in_words_have_what_is_not_zero(name: str):
    values = drift.PRESETS[name]
    words = module.words(values)
    assert ("% of the distance" in words) == (values.scale_error > 0)
    assert ("positions off by" in words) == (values.position_walk_m > 0)
    assert "\n" not in words


def test_no_drift_is_none_in_words():
    assert module.words(drift.Settings(0, 0, 0, 1, 0, 1)) == "none"
    assert module.words(drift.PRESETS["gyrocompass"]) == (
        "0.2 % of the distance; heading off by 0.069 deg and wandering by 0.069 deg; velocity by 4 mm/s"
    )


@pytest.mark.parametrize(
    "change",
    [
        {"navigation": "gps"},
        {"submap_length_m": -1.0},
        {"point_spacing_m": float("nan")},
        {"cell_m": -0.5},
        {"max_gap_m": float("inf")},
        {"left_out_gain": 1.5},
        {"left_out_p": -0.1},
        {"overlap_points": 0},
        {"target_points": -3},
        {"max_turn_rad": 0.0},
        {"utm_zone": "33N"},
        {"sbet_clock": "tai"},
        {"seed": -1},
    ],
)
def test_settings_out_of_range_are_refused_by_their_name(change: dict):
    (name,) = change
    with pytest.raises(ValueError, match=f"^{name} is"):
        Settings(**change)


def test_the_parameters_of_the_study_are_settings():
    parameters.read(PARAMS, "correct", Settings)


@pytest.mark.parametrize("points", [1.0, 60.0, 400.0, 4000.0, 60_000.0, 1e6, 1e8])
def test_closures_can_be_searched_among_submaps_of_any_size(points: float):
    search = Settings().close(1.0, points).search
    assert 0 < search.target_coverage <= search.coverage <= 0.6


def test_the_share_of_overlap_stands_for_a_number_of_points():
    search = Settings(overlap_points=200, target_points=40).close(1.0, 4000.0).search
    assert (search.coverage, search.target_coverage) == pytest.approx((0.05, 0.01))


def test_the_search_reaches_at_least_a_spacing_and_what_is_asked_for():
    usual = Settings().closing.search.search_variance_m2
    assert Settings().close(0.1, 4000.0).search.search_variance_m2 == usual
    assert Settings().close(50.0, 4000.0).search.search_variance_m2 == 2500.0


def test_registrations_scale_with_the_spacing():
    fine, coarse = module.registration(0.5), module.registration(20.0)
    assert coarse.max_distance_m == 40 * fine.max_distance_m
    assert (fine.method, fine.dimensions) == ("map", 2)
