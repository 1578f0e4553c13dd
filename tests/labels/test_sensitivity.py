"""What labels depend on: the study's draws, its parts and its submaps, and what it must find on made-up seabeds."""

import dataclasses
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import terrains
from pointnetkl.labels import sensitivity
from pointnetkl.registration import gicp, monte_carlo
from pointnetkl.registration.covariance import label_table
from pointnetkl.segmentation import spacing
from pointnetkl.surveys import submap
from pointnetkl.surveys.submap import Submap
from pointnetkl.workflow import artifacts

ROOT = Path(__file__).parents[2]
KINDS = ("rugged", "flat", "mild")
CELL_M = 4.0
REGISTRATION = gicp.Settings(20, 1e-3, 20.0, 1e-3, 50)
LABEL = monte_carlo.Settings(seed=2, copy="same", prior_variance_m2=9.0, noise_sigma_m=0.2, held_out_runs=10)
SETTINGS = sensitivity.Settings(
    seed=10,
    submaps=2,
    runs=60,
    run_counts=[13, 30, 3000],
    compared_runs=20,
    thinnings=[1.0, 2.0],
    noise_sigmas_m=[0.0, 0.2],
)


def make(kind: str, number: int) -> Submap:
    points, first, second = (terrains.cloud(kind, 2500, p) for p in range(3))
    rng = np.random.default_rng(number)
    return Submap("small", number, *(p[spacing.thin(p, CELL_M, rng)] for p in (points, first, second)))


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A file of three submaps: rugged, flat, mild."""
    file = tmp_path_factory.mktemp("vary") / "small.parquet"
    submaps = [make(kind, number) for number, kind in enumerate(KINDS)]
    artifacts.write_table(file, submap.to_table(submaps), submap.POINTS, {})
    return file


def variation(number: int, study: str = label_table.CONDITIONS, **change: Any) -> sensitivity.Variation:
    usual = sensitivity.Variation(number, study, "same", 0.2, 1.0, 60)
    return dataclasses.replace(usual, **change)


def rows(path: Path, varied: sensitivity.Variation) -> pd.DataFrame:
    labels = sensitivity.rows(varied, "small", path, CELL_M, SETTINGS, LABEL, REGISTRATION)
    return pd.DataFrame(labels, columns=label_table.VARIATIONS.names)


def trace(path: Path, varied: sensitivity.Variation) -> float:
    (row,) = rows(path, varied).itertuples()
    return row.q_xx_m2 + row.q_yy_m2


def test_submaps_are_chosen_from_flat_to_rugged(path: Path):
    rugged = [sensitivity.ruggedness(cloud, REGISTRATION) for cloud in submap.stream("small", path)]
    assert [KINDS[place] for place in sensitivity.spread(rugged, 3)] == ["flat", "mild", "rugged"]
    assert [KINDS[place] for place in sensitivity.spread(rugged, 1)] == ["mild"]
    assert len(sensitivity.spread(rugged, 50)) == 3
    assert sensitivity.spread(list(range(100)), 4) == [12, 37, 62, 87]


def test_a_ridge_is_less_rugged_than_what_leans_both_ways():
    ridge, mild = (sensitivity.ruggedness(make(kind, 0), REGISTRATION) for kind in ("ridge", "mild"))
    assert ridge < 0.2 * mild


def test_every_condition_is_asked_for_once_for_both_copies():
    variations = sensitivity.variations([4, 7], SETTINGS, LABEL)
    assert len(variations) == len(set(variations)) == 2 * (1 + 2 * 3)
    assert [varied.submap for varied in variations if varied.study == label_table.RUNS] == [4, 7]
    conditions = {
        (varied.copy, varied.noise_sigma_m, varied.thinning)
        for varied in variations
        if varied.study == label_table.CONDITIONS
    }
    assert conditions == {(c, *o) for c in ("same", "split") for o in ((0.2, 1.0), (0.2, 2.0), (0.0, 1.0))}


def test_parts_share_no_run_and_the_last_row_is_the_whole(path: Path):
    labels = rows(path, variation(1, label_table.RUNS))
    assert labels.groupby("runs")["repeat"].apply(list).to_dict() == {13: [0, 1, 2, 3], 30: [0, 1], 60: [0]}
    halves, complete = labels[labels["runs"] == 30], labels.iloc[-1]
    # second moments of parts add up to that of the whole
    assert (29 * halves["q_xx_m2"]).sum() == pytest.approx(59 * complete["q_xx_m2"])


def test_a_part_of_all_runs_is_the_label_of_so_many(path: Path):
    long, short = rows(path, variation(1, label_table.RUNS)), rows(path, variation(1, runs=30))
    first = long[(long["runs"] == 30) & (long["repeat"] == 0)]
    assert first["q_xx_m2"].item() == short["q_xx_m2"].item()


def test_an_unvaried_label_is_that_of_the_label_s_estimator(path: Path):
    settings = dataclasses.replace(LABEL, seed=SETTINGS.seed)
    expected = monte_carlo.label(submap.read("small", path, 1), 60, settings, REGISTRATION).row
    (labels,) = rows(path, variation(1)).to_dict("records")
    for name in ("q_xx_m2", "q_xy_m2", "relative_error", "mean_x_m", "main_basin_share", "spacing_m"):
        assert labels[name] == pytest.approx(expected[name])


def test_the_label_of_a_rugged_copy_grows_as_the_square_of_its_noise(path: Path):
    low, high = (trace(path, variation(0, noise_sigma_m=sigma)) for sigma in (0.02, 0.2))
    assert high / low == pytest.approx(100, rel=0.2)
    assert trace(path, variation(0, noise_sigma_m=0.0)) < 1e-8


def test_the_label_of_a_flat_copy_hardly_depends_on_its_noise(path: Path):
    low, high = (trace(path, variation(1, noise_sigma_m=sigma)) for sigma in (0.02, 0.2))
    assert high / low == pytest.approx(1, rel=0.3)


def test_a_coarse_flat_copy_finds_itself_and_another_pass_does_not(path: Path):
    same, split = (trace(path, variation(1, thinning=4.0, copy=copy)) for copy in ("same", "split"))
    assert same < 0.1 * trace(path, variation(1))
    assert split > 10 * same


def test_thinning_keeps_one_point_of_each_coarser_cell_in_every_part():
    cloud = make("mild", 0)
    coarse = sensitivity.thinned(cloud, 2.0, CELL_M, 1)
    for part, dense in ((coarse.points, cloud.points), (coarse.first, cloud.first), (coarse.second, cloud.second)):
        assert len(part) == len(np.unique(spacing.cells(dense, 2 * CELL_M)))
    assert sensitivity.thinned(cloud, 1.0, CELL_M, 1) is cloud


@pytest.mark.parametrize(
    "change",
    [
        {"seed": -1},
        {"submaps": 0},
        {"runs": 2},
        {"compared_runs": 2},
        {"run_counts": [2]},
        {"run_counts": [100_000]},
        {"thinnings": [0.5]},
        {"thinnings": []},
        {"noise_sigmas_m": [-0.1]},
    ],
)
def test_settings_that_make_no_sense_are_refused(change: dict[str, Any]):
    with pytest.raises(ValueError, match=f"^{next(iter(change))} is "):
        dataclasses.replace(SETTINGS, **change)


@pytest.mark.slow
def test_the_stage_writes_the_same_table_whatever_the_workers(tmp_path: Path, path: Path):
    params = (ROOT / "params.yaml").read_text()
    line = "{group: test, raw: a, truth: data/none, submap_length_m: 100, point_spacing_m: 4.0, label_runs: 9}"
    text = params.replace("  test: &test\n", f"  test: &test\n    small: {line}\n")
    for old, new in (("submaps: 3  # of each", "submaps: 2  #"), ("runs: 9000  # parts", "runs: 60  # parts")):
        assert text.count(old) == 1
        text = text.replace(old, new)
    (tmp_path / "params.yaml").write_text(text.replace("compared_runs: 200", "compared_runs: 20"))
    written = []
    for workers in ("1", "2"):
        out = tmp_path / f"{workers}.parquet"
        command = [sys.executable, ROOT / "pipeline/vary.py", "small", "--submaps", path, "--variations", out]
        environment = {"PATH": "", "PYTHONPATH": str(ROOT / "src"), "POINTNETKL_WORKERS": workers}
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, env=environment, check=False)
        assert done.returncode == 0, done.stderr
        written.append(out.read_bytes())
    assert written[0] == written[1]
    labels = artifacts.read_table(out, label_table.VARIATIONS)
    assert set(labels["copy"]) == {"same", "split"}
    assert labels["submap"].nunique() == 2
    assert artifacts.table_metadata(out)["params"]["label"]["noise_sigma_m"] == 0.2
