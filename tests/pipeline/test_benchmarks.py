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
    found: dict[str, Any] = json.loads(result.stdout.splitlines()[-1])
    return found


def test_the_race_with_small_gicp_ends_in_its_numbers() -> None:
    pytest.importorskip("small_gicp")
    found = last_line("gicp", "--runs", "4", "--repetitions", "2", "--terrain", "rugged")
    for name in ("ours_ms", "small_gicp_ms", "ratio", "ratio_prepared", "ours_prepare_once_ms", "ours_yaw_ms"):
        assert found[name] > 0
    assert found["small_gicp_prepared_ms"] < found["small_gicp_ms"]
    assert found["ratio_range"][0] <= found["ratio"] <= found["ratio_range"][1]
    assert [row["submap"] for row in found["submaps"]] == ["borno_8 rugged", "thwaites_11 rugged"]
    # the same noise on both can only bring two distributions closer
    assert 0 <= found["kl_between_covariances"] <= found["kl_between_covariances_floor0"]
    assert found["versions"]["small_gicp"]


@pytest.mark.parametrize("copy", ["same", "split"])
def test_the_kernel_has_the_references_answer_on_simulated_ground(copy: str) -> None:
    options = ("--submaps", "4", "--runs", "10", "--production-runs", "12", "--copy", copy)
    found = last_line("agreement", *options)
    assert found["share_within_1mm"] >= 0.99
    assert found["kl_largest_floor0"] < 1e-3
    assert found["submaps_within_kl_goal"] == len(found["submaps"]) == 4
    assert found["runs_apart"] == len(found["apart"])


def test_the_gain_of_a_second_worker_ends_in_its_numbers() -> None:
    found = last_line("scaling", "--submaps", "2", "--runs", "10", "--repetitions", "1")
    assert found["workers"] == 2
    assert found["efficiency"] == pytest.approx(found["seconds_one"] / (2 * found["seconds_many"]), rel=1e-3)


@pytest.mark.parametrize(
    ("script", "options", "why"),
    [
        ("gicp", ("--repetitions", "0"), "--repetitions 0"),
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
