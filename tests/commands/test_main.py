"""`python -m pointnetkl predict`: a row for each file, and a sentence for each that is none."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import pointnetkl
import terrains
import toy_models
from pointnetkl import __main__ as command


def submap(folder: Path, name: str, number: int = 60) -> Path:
    np.savez(folder / name, points=terrains.cloud("mild", 900, number))
    return folder / name


@pytest.mark.parametrize("kind", toy_models.KINDS)
def test_json_has_what_the_estimator_says(tmp_path: Path, capsys: pytest.CaptureFixture, kind: str):
    model, file = toy_models.write(tmp_path, kind), submap(tmp_path, "s.npz")
    assert command.main(["predict", str(model), str(file), "--json"]) == 0
    (row,) = json.loads(capsys.readouterr().out)
    judged = pointnetkl.CovarianceEstimator.load(model).judge(terrains.cloud("mild", 900, 60))
    q = np.array([[row["q_xx_m2"], row["q_xy_m2"]], [row["q_xy_m2"], row["q_yy_m2"]]])
    np.testing.assert_allclose(q, judged.covariance)
    assert (row["file"], row["points"], row["novelty"], row["far"]) == (str(file), 900, judged.novelty, False)
    c, s = np.cos(np.deg2rad(row["angle_deg"])), np.sin(np.deg2rad(row["angle_deg"]))
    axes = np.array([[c, -s], [s, c]])
    np.testing.assert_allclose(axes @ np.diag([row["major_m"] ** 2, row["minor_m"] ** 2]) @ axes.T, q)


def test_a_bad_file_is_named_and_the_others_are_printed(tmp_path: Path):
    model, file = toy_models.write(tmp_path, "pointnetkl"), submap(tmp_path, "good.npz")
    np.savez(tmp_path / "flat.npz", points=np.ones((50, 3)))
    words = [sys.executable, "-m", "pointnetkl", "predict", model, tmp_path / "gone.pcd", tmp_path / "flat.npz", file]
    result = subprocess.run(list(map(str, words)), capture_output=True, text=True)
    assert result.returncode == 1
    gone, flat = result.stderr.splitlines()
    assert gone == f"error: {tmp_path / 'gone.pcd'}: cannot be read (No such file or directory)"
    assert flat.startswith(f"error: {tmp_path / 'flat.npz'}: all 50 points lie on a line")
    head, row = result.stdout.splitlines()
    assert head.split()[:5] == ["file", "points", "major_m", "minor_m", "angle_deg"]
    assert row.split()[:2] == [str(file), "900"]
    assert row.split()[-1] == "no"


def test_with_yaw_its_entries_are_columns_too(tmp_path: Path, capsys: pytest.CaptureFixture):
    model = toy_models.write(tmp_path, "mean_field", dimensions=3)
    assert command.main(["predict", str(model), str(submap(tmp_path, "s.npz"))]) == 0
    assert "q_ww_rad2" in capsys.readouterr().out.split()


def test_a_file_that_is_no_model_ends_the_command(tmp_path: Path, capsys: pytest.CaptureFixture):
    (tmp_path / "m.pt").write_bytes(b"PK")
    assert command.main(["predict", str(tmp_path / "m.pt"), "s.npz"]) == 1
    printed = capsys.readouterr()
    assert printed.err.startswith(f"error: {tmp_path / 'm.pt'}: is damaged")
    assert (printed.out, printed.err.count("\n")) == ("", 1)


def test_help_says_what_goes_in_and_what_comes_out(capsys: pytest.CaptureFixture):
    with pytest.raises(SystemExit) as ended:
        command.main(["predict", "--help"])
    assert ended.value.code == 0
    printed = capsys.readouterr().out
    assert all(word in printed for word in ("PCD", "PLY", "NPZ", "--json", "angle_deg", "novelty", "exit status"))
