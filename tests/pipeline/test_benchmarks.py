"""The benchmarks, at a tiny size: what they print is complete, and what they refuse they refuse in one sentence."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]
SMALL = ("--points", "300", "--seed", "3")


def run(script: str, *options: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, f"benchmarks/{script}.py", *options]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True)


def last_line(script: str, *options: str) -> dict[str, Any]:
    result = run(script, *SMALL, "--json", *options)
    assert result.returncode == 0, result.stderr
    numbers: dict[str, Any] = json.loads(result.stdout.splitlines()[-1])
    return numbers


def test_the_race_with_small_gicp_ends_in_its_numbers() -> None:
    pytest.importorskip("small_gicp")
    numbers = last_line("gicp", "--runs", "4", "--repetitions", "2", "--terrain", "rugged")
    for name in ("ours_ms", "small_gicp_ms", "ratio", "ratio_prepared", "ours_prepare_once_ms", "ours_yaw_ms"):
        assert numbers[name] > 0
    assert numbers["small_gicp_prepared_ms"] < numbers["small_gicp_ms"]
    assert numbers["ratio_range"][0] <= numbers["ratio"] <= numbers["ratio_range"][1]
    assert [row["submap"] for row in numbers["submaps"]] == ["borno_8 rugged", "thwaites_11 rugged"]
    # the same noise on both can only bring two distributions closer
    assert 0 <= numbers["kl_between_covariances"] <= numbers["kl_between_covariances_floor0"]
    assert numbers["versions"]["small_gicp"]


def test_a_loop_closure_by_map_ends_in_its_numbers() -> None:
    numbers = last_line("pair", "--runs", "3", "--repetitions", "2", "--terrain", "rugged")
    for name in ("gicp_ms", "map_ms", "pair_ms", "ratio", "covariance_ms", "factor_ms", "pair_yaw_ms", "ratio_largest"):
        assert numbers[name] > 0
    assert [row["submap"] for row in numbers["submaps"]] == ["borno_8 rugged", "thwaites_11 rugged"]
    assert all(0 <= row["rank"] <= 2 and row["map_rms_m"] > 0 for row in numbers["submaps"])


def test_closures_of_a_survey_sailed_anew_end_nearer_to_the_truth_by_map() -> None:
    result = run("placed", "--surveys", "borno_8", "--seeds", "1", "--halves", "6", "--json")
    assert result.returncode == 0, result.stderr
    numbers = json.loads(result.stdout.splitlines()[-1])
    everything = [row for row in numbers["classes"] if row["survey"] == "all"]
    assert sum(row["closures"] for row in everything) == numbers["closures"] > 20
    held = everything[-1]
    assert held["ground"] == "held"
    assert held["map_rms_m"] < 0.2
    assert held["map_in_95"] > 0.8
    assert held["own_in_95"] > 0.7
    assert held["halves_nees"] > 0


def test_a_covariance_of_one_registration_is_refused() -> None:
    result = run("placed", "--halves", "1")
    assert result.returncode == 1
    assert result.stderr.startswith("error: --halves is 1, must be 0, or 2 and above")


@pytest.mark.parametrize("copy", ["same", "split"])
def test_the_kernel_has_the_references_answer_on_simulated_ground(copy: str) -> None:
    options = ("--submaps", "4", "--runs", "10", "--production-runs", "12", "--copy", copy)
    numbers = last_line("agreement", *options)
    assert numbers["share_within_1mm"] >= 0.99
    assert numbers["kl_largest_floor0"] < 1e-3
    assert numbers["submaps_within_kl_goal"] == len(numbers["submaps"]) == 4
    assert numbers["runs_apart"] == len(numbers["apart"])


def test_the_gain_of_a_second_worker_ends_in_its_numbers() -> None:
    numbers = last_line("scaling", "--submaps", "2", "--runs", "10", "--repetitions", "1")
    assert numbers["workers"] == 2
    assert numbers["efficiency"] == pytest.approx(numbers["seconds_one"] / (2 * numbers["seconds_many"]), rel=1e-3)


@pytest.mark.parametrize(
    ("script", "options", "why"),
    [
        ("gicp", ("--repetitions", "0"), "--repetitions 0"),
        ("placed", ("--surveys", "nowhere"), "nowhere"),
        ("pair", ("--runs", "0"), "--runs is 0"),
        ("agreement", ("--submaps", "1"), "--submaps is 1"),
        ("scaling", ("--workers", "1"), "--workers"),
        ("agreement", ("--params", "nowhere.yaml"), "nowhere.yaml"),
        ("agreement", ("--points", "2"), "3 or more points"),
    ],
)
def test_what_cannot_be_measured_is_refused_in_one_sentence(script: str, options: tuple[str, ...], why: str) -> None:
    result = run(script, *options)
    assert result.returncode == 1
    last = result.stderr.strip().splitlines()[-1]
    assert last.startswith("error: ")
    assert why in last
    assert "Traceback" not in result.stderr
