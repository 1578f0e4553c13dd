"""Ingest: raw pings become three tables in one map frame, or an error is one sentence."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from generic_files import parquet, rows
from pointnetkl import readers
from pointnetkl.surveys.survey import PINGS, SOUNDINGS, TRAJECTORY
from pointnetkl.workflow import artifacts, parameters

ROOT = Path(__file__).parents[2]


def ingest(folder: Path, *changes: str) -> subprocess.CompletedProcess[str]:
    """Run the stage's script on the raw pings and the truth of a folder."""
    outliers = "{sigmas: 8.0, depth_share: 0.05}"
    (folder / "params.yaml").write_text(f"ingest: {{utm_zone: auto, outliers: {outliers}}}\n")
    command = [sys.executable, ROOT / "pipeline/ingest.py", "mine", "--params", folder / "params.yaml"]
    command += [
        "--raw",
        folder / "raw.parquet",
        "--truth",
        folder / "truth.parquet",
        "--out",
        folder / "out",
        *changes,
    ]
    return subprocess.run(command, capture_output=True, text=True, cwd=folder)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with raw pings and an unknown truth."""
    parquet(tmp_path / "raw.parquet", rows(pings=20, heading=1.0))
    (tmp_path / "truth.parquet").write_text("none")
    return tmp_path


def trajectory(**columns: object) -> pd.DataFrame:
    """Return a true trajectory at the times of the raw pings."""
    time = 1.5e9 + 5.0 * np.arange(20)
    table = pd.DataFrame({"time_s": time, "x_m": 5e5 + time - time[0], "y_m": 6e6 + 1.0, "z_m": -20.0, "yaw_rad": 0.5})
    return table.assign(**columns)


def test_three_tables_and_a_summary_come_out(folder: Path):
    result = ingest(folder)
    assert result.returncode == 0, result.stderr
    assert "mine: 20 pings, 100 soundings, 100 valid, track 190 m, depth 50.00 to 54.00 m, EPSG:32633" in result.stdout
    assert "skipped: nothing" in result.stdout
    pings = artifacts.read_table(folder / "out/pings.parquet", PINGS)
    soundings = artifacts.read_table(folder / "out/soundings.parquet", SOUNDINGS)
    assert (len(pings), len(soundings)) == (20, 100)
    assert artifacts.read_table(folder / "out/truth.parquet", TRAJECTORY).empty


def test_a_file_that_says_none_means_an_unknown_truth(folder: Path):
    (folder / "truth.parquet").write_text("none: as data/none does\n")
    assert ingest(folder).returncode == 0
    assert artifacts.read_table(folder / "out/truth.parquet", TRAJECTORY).empty


def test_every_table_says_whence_it_came(folder: Path):
    ingest(folder)
    for name in ("pings", "soundings", "truth"):
        metadata = artifacts.table_metadata(folder / f"out/{name}.parquet")
        assert metadata["survey"] == "mine"
        assert metadata["crs"] == "EPSG:32633"
        assert metadata["origin"] == [5e5, 6e6]
        assert metadata["report"]["pings"] == 20
        outliers = {"sigmas": 8.0, "depth_share": 0.05}
        assert metadata["params"] == {"utm_zone": "auto", "sbet_clock": "gps", "outliers": outliers}


def test_the_truth_comes_into_the_map_frame(folder: Path):
    parquet(folder / "truth.parquet", trajectory())
    assert ingest(folder).returncode == 0
    truth = artifacts.read_table(folder / "out/truth.parquet", TRAJECTORY)
    np.testing.assert_allclose(truth["x_m"], 5.0 * np.arange(20))
    np.testing.assert_allclose(truth[["y_m", "z_m", "yaw_rad"]].iloc[0], [1.0, -20.0, 0.5])


@pytest.mark.parametrize(
    ("columns", "crs", "cause"),
    [
        ({}, "EPSG:32634", "is in EPSG:32634 and the survey in EPSG:32633"),
        ({"x_m": np.nan}, "EPSG:32633", "20 of its 20 rows are not finite"),
        ({"time_s": 7.0}, "EPSG:32633", "has no time within the survey's"),
    ],
)
def test_a_truth_that_is_not_the_survey_s_is_refused(folder: Path, columns: dict[str, float], crs: str, cause: str):
    parquet(folder / "truth.parquet", trajectory(**columns), crs=crs)
    result = ingest(folder)
    assert result.returncode == 1
    assert cause in result.stderr
    assert "Traceback" not in result.stderr


@pytest.mark.slow
def test_the_same_raw_pings_give_the_same_bytes(folder: Path):
    ingest(folder)
    ingest(folder, "--out", str(folder / "again"))
    for name in ("pings", "soundings", "truth"):
        assert (folder / f"out/{name}.parquet").read_bytes() == (folder / f"again/{name}.parquet").read_bytes()


def test_what_cannot_be_read_ends_in_one_sentence(folder: Path):
    for raw in ("nowhere", "truth.parquet"):
        result = ingest(folder, "--raw", str(folder / raw))
        assert result.returncode == 1
        assert result.stderr.startswith("error: ")
        assert result.stderr.count("\n") == 1
    result = ingest(folder, "--truth", str(folder / "nowhere"))
    assert "nowhere: is missing; data/none says that the truth is unknown" in result.stderr


def test_a_zone_that_is_none_is_refused_before_anything_is_read(tmp_path: Path):
    (tmp_path / "params.yaml").write_text("ingest: {utm_zone: 33N}\n")
    with pytest.raises(parameters.SettingsError, match="utm_zone is '33N', must be auto or a code"):
        parameters.read(tmp_path / "params.yaml", "ingest", readers.Settings)


def test_what_is_projected_is_read_without_the_libraries_that_it_does_not_need(folder: Path):
    heavy = {"pyproj", "GSFU", "torch", "numba", "open3d", "matplotlib"}
    code = "import sys; from pathlib import Path; from pointnetkl import readers\n"
    code += f"readers.read(Path({str(folder / 'raw.parquet')!r}), readers.Settings('auto'), lambda part: None)\n"
    code += f"assert not {heavy} & set(sys.modules)"
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0
