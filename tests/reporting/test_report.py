"""The whole report from made-up artifacts: what it holds, what it refuses, and that it comes out the same twice."""

import dataclasses
import io
import json
import re
import shutil
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import yaml

import fake_artifacts
from pointnetkl.registration.covariance import gaussian, label_table
from pointnetkl.reporting import report, results, terrain
from pointnetkl.reporting.covariances import numbers as covariances
from pointnetkl.reporting.covariances import tables as covariance_tables
from pointnetkl.reporting.surveys import numbers as surveys
from pointnetkl.workflow import artifacts, parameters, study

UNTIMED = re.compile(r"table_3|index\.html|accuracy_time|cost_accuracy")


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a small study's artifacts."""
    folder = tmp_path_factory.mktemp("fake")
    fake_artifacts.write(folder)
    return folder


def folders_of(folder: Path) -> results.Folders:
    """Return where a folder's artifacts are."""
    return results.Folders(folder / "data", folder / "models", folder / "reports", study.read(folder / "params.yaml"))


@pytest.fixture(scope="module")
def folders(root: Path) -> results.Folders:
    """Where its artifacts are."""
    return folders_of(root)


def make(folder: Path) -> report.Report:
    """Return the report of a folder's artifacts."""
    params = folder / "params.yaml"
    return report.make(
        folders_of(folder),
        parameters.read(params, "report", results.Settings),
    )


@pytest.fixture(scope="module")
def made(root: Path) -> report.Report:
    """The report of the made-up study."""
    return make(root)


@pytest.fixture(scope="module")
def numbers(made: report.Report) -> dict[str, dict]:
    """Its metrics.json."""
    return json.loads(made.files["metrics.json"])


@pytest.fixture
def copy(root: Path, tmp_path: Path) -> Path:
    """A copy of the artifacts to spoil."""
    return Path(shutil.copytree(root, tmp_path / "copy"))


@pytest.mark.slow
def test_the_same_artifacts_give_the_same_bytes_whatever_the_run_times(copy: Path, made: report.Report):
    times = artifacts.read_json(copy / "reports/runtime.json")
    slower = {name: {"mean_s": 5.0, "std_s": 1.0} for name in ("pointnetkl", "monte_carlo")}
    artifacts.write_json(copy / "reports/runtime.json", times | slower)
    again = make(copy).files
    changed = {name for name in made.files if again[name] != made.files[name]}
    assert changed == {name for name in made.files if UNTIMED.search(name)}


def test_metrics_have_every_key_of_the_specification(numbers: dict[str, dict]):
    assert set(numbers["datasets"]["baltic"]) == {
        *("simulated", "vehicle", "submaps", "area_km2", "track_km", "sigma_z"),
        *("points_mean", "points_std", "spacing_m"),
    }
    assert set(numbers["kl"]["borno_8"]["network"]) == {"mean", "median", "ci95", "mean_floor0", "axis_error_deg"}
    assert set(numbers["kl"]["borno_8"]["pointnetkl"]) - set(numbers["kl"]["borno_8"]["network"]) == {"network_better"}
    assert set(numbers["calibration"]["borno_8"]["monte_carlo"]) == {
        "nees", "coverage_50", "coverage_90", "coverage_95", "coverage_99"
    }  # fmt: skip
    assert {"training", "validation", "borno_8", "mine"} == set(numbers["kl"])
    assert set(numbers["kl_by_class"]["borno_8"]["wall"]["network"]) == {"mean", "submaps"}
    assert set(numbers["calibration_by_class"]["mine"]["rugged"]["network"]) == {"nees", "coverage_95", "submaps"}
    assert numbers["slam"]["borno_8"]["dead_reckoning_edges"] == 17
    assert set(numbers["slam"]["borno_8"]["constant"]) >= {
        *("rmse_xyz_m", "rmse_xyz_ci95_m", "truth_rmse_xyz_m", "map_to_map_m", "pose_nees", "truth_relative_m"),
        *("draws_truth_rmse_xyz_m", "draws_truth_rmse_xyz_ci95_m", "network_minus_m", "network_p"),
        *("network_minus_ci95_m", "network_minus_se2_ci95_m", "network_minus_relative_ci95_m"),
    }


def test_metrics_have_four_digits_and_no_nan(made: report.Report):
    text = made.files["metrics.json"].decode()
    assert "NaN" not in text
    assert "null" not in text
    every = [number for _, number in leaves(json.loads(text)) if isinstance(number, float)]
    assert every == [float(f"{number:.4g}") for number in every]


def leaves(value: object, path: str = "") -> Iterator[tuple[str, object]]:
    """Yield every value of nested dicts and lists with its path."""
    inner = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else None
    if inner is None:
        yield path, value
    for key, each in inner or ():
        yield from leaves(each, f"{path}.{key}")


def test_the_headline_has_numbers_of_metrics_and_of_the_table_of_labels(made: report.Report, numbers: dict[str, dict]):
    headline = json.loads(made.files["headline.json"])
    assert list(headline) == list(fake_artifacts.TEST)
    labels = pd.read_csv(io.BytesIO(made.files["tables/labels.csv"]))
    for name, each in headline.items():
        assert each["KL_nats"] == {method: numbers["kl"][name][method]["mean"] for method in each["KL_nats"]}
        (row,) = labels[
            (labels["survey"] == name) & (labels["eigenvalue"] == "larger") & (labels["of"] == "labels")
        ].to_dict("records")
        assert each["label_larger_m2"] == {key: row[f"{key}_m2"] for key in ("q05", "q50", "q95")}
    assert "slam_gt_m" in headline["mine"]


def test_what_is_not_known_of_a_user_s_survey_is_left_out(numbers: dict[str, dict]):
    assert numbers["datasets"]["mine"]["simulated"] is False
    assert numbers["datasets"]["mine"]["vehicle"] == "unknown"
    assert set(numbers["slam"]["mine"]["pointnetkl"]) == {"rmse_xyz_m", "rmse_xyz_ci95_m", "pose_nees"}
    assert numbers["slam"]["mine"]["loop_closures"] == 0


def test_numbers_are_those_of_the_metrics_module(folders: results.Folders, numbers: dict[str, dict]):
    labels = results.read_labels(folders, "borno_8")
    test = results.read_test(folders, "borno_8", labels)
    expected = gaussian.divergence(labels.q, test.covariances["constant"], 0.01).mean()
    assert numbers["kl"]["borno_8"]["constant"]["mean"] == pytest.approx(expected, rel=1e-3)
    first = (test.slam["variant"] == "table") & (test.slam["draw"] == 0)
    rows = test.slam[first & (test.slam["method"] == "constant")]
    assert numbers["slam"]["borno_8"]["constant"]["rmse_xyz_m"] == pytest.approx(rows["rmse_xyz_m"].mean(), rel=1e-3)


def test_the_label_itself_is_not_listed_as_close_to_the_label(numbers: dict[str, dict]):
    assert "monte_carlo" not in numbers["kl"]["borno_8"]


def test_an_interval_does_not_change_when_a_method_leaves(folders: results.Folders):
    labels = results.read_labels(folders, "borno_8")
    test = results.read_test(folders, "borno_8", labels)
    chosen = results.Settings(9, 0.01, 2.0, 5, terrain.Settings(0.004, 0.02))
    every = covariances.judged(labels, test)
    only = dataclasses.replace(every, covariances={"pointnetkl": test.covariances["pointnetkl"]})
    intervals = [covariances.divergences("borno_8", each, chosen)["pointnetkl"]["ci95"] for each in (every, only)]
    assert intervals[0] == intervals[1]


def test_terrain_that_only_a_test_survey_has_stands_in_rows_marked_so(made: report.Report, numbers: dict[str, dict]):
    assert numbers["terrain"]["borno_8"]["wall"]["in_training"] is False
    assert numbers["terrain"]["borno_8"]["wall"]["submaps"] == 6  # the third line's
    rows = pd.read_csv(io.BytesIO(made.files["tables/by_class.csv"]))
    marked = rows[rows["training"] == covariance_tables.UNSEEN]
    assert set(zip(marked["survey"], marked["class"], strict=True)) == {("borno_8", "wall")}
    assert set(marked["method"]) == set(fake_artifacts.METHODS)


def test_a_survey_that_nobody_simulated_is_judged_by_its_points(numbers: dict[str, dict]):
    assert set(numbers["terrain"]["mine"]) <= {"flat", "smooth", "rugged"}
    assert sum(each["submaps"] for each in numbers["terrain"]["mine"].values()) == 18


@pytest.mark.slow
def test_what_was_trained_at_another_floor_is_left_out_of_table_2(made: report.Report, copy: Path):
    def row(method: str, files: Mapping[str, bytes]) -> pd.Series:
        return pd.read_csv(io.BytesIO(files["tables/table_2.csv"])).set_index("method").loc[method]

    assert row("network", made.files)["validation"] == 0.81
    assert np.isnan(row("constant_train", made.files)["training"])  # fitted at a floor of 0.02
    artifacts.write_json(copy / "reports/train/network.json", {"kl": {"training": 1, "validation": 2}, "floor_m2": 0.0})
    assert np.isnan(row("network", make(copy).files)["validation"])


def test_a_model_without_its_floor_is_refused(copy: Path):
    artifacts.write_json(copy / "reports/train/network.json", {"kl": {"training": 1, "validation": 2}})
    with pytest.raises(results.ResultsError, match=r"network\.json: must have .* floor_m2"):
        make(copy)


def test_the_area_is_the_union_of_footprints():
    clouds = [np.mgrid[0.5:10, 0.5:10].reshape(2, -1).T @ np.eye(2, 3)] * 2
    poses = pd.DataFrame({"x_m": [0.0, 5.0], "y_m": 0.0, "z_m": 0.0, "yaw_rad": 0.0})
    assert surveys.area_km2(clouds, poses, 1.0) == pytest.approx(150e-6)


def test_only_a_survey_whose_truth_was_simulated_is_simulated(folders: results.Folders):
    simulated = {name: results.read_simulation(folders, name) for name in folders.study.surveys}
    assert [name for name, settings in simulated.items() if settings is None] == ["mine"]
    assert simulated["baltic"].vehicle == "hugin"


@pytest.mark.parametrize(
    "name",
    [
        "data/train/baltic/labels.parquet",
        "data/test/mine/variations.parquet",
        "reports/slam/mine.parquet",
        "reports/runtime.json",
        "models/fits.json",
    ],
)
def test_a_missing_artifact_is_named_before_anything_is_made(copy: Path, name: str):
    (copy / name).unlink()
    with pytest.raises(results.ResultsError, match=re.escape(name)):
        make(copy)


def test_covariances_of_other_submaps_than_the_labels_are_refused(copy: Path):
    path = copy / "data/test/borno_8/labels.parquet"
    rows = artifacts.read_table(path, label_table.LABELS)
    artifacts.write_table(path, rows.iloc[:-1], label_table.LABELS, artifacts.table_metadata(path))
    with pytest.raises(results.ResultsError, match=r"borno_8/estimated.*18 submaps.*17 labels"):
        make(copy)


def test_without_held_out_errors_nothing_is_said_of_calibration(folders: results.Folders):
    labels = results.read_labels(folders, "borno_8")
    test = results.read_test(folders, "borno_8", labels)
    of = covariances.judged(labels, test)
    assert covariances.calibrations(dataclasses.replace(of, held_out=of.held_out[:, :0])) == {}


def test_the_page_stands_alone(made: report.Report):
    page = made.files["index.html"].decode()
    beside = re.findall(r'(?:src|href)="(?!data:|#)([^"]*)', page)
    assert beside == ["this_machine.js"]  # which it can do without
    assert "http" not in re.sub(r'src="data:[^"]*"', "", page)
    shown = [name for name in made.files if name.startswith("figures/") and not name.startswith("figures/worst/")]
    ours = {"network", "pointnetkl", "structure_tensor"} & set(fake_artifacts.METHODS)  # whose worst submaps it shows
    assert page.count("data:image/png") == len(shown) + len(ours)
    assert 'name="viewport"' in page


def test_the_page_says_what_is_simulated_and_at_which_scale(made: report.Report):
    page = made.files["index.html"].decode()
    assert "Simulated: baltic, borno_1, borno_8." in page
    assert "Measured: mine." in page
    assert "Scale smoke" in page


def test_the_page_says_which_copy_the_labels_are_of_and_what_training_has_not_seen(made: report.Report):
    page = made.files["index.html"].decode()
    assert "All labels here are of label.copy same." in page
    assert "Rows marked not in training: borno_8: wall (6 submaps)." in page


def test_every_table_names_every_survey_and_never_nan(made: report.Report):
    for number in (1, 2, 4):
        text = made.files[f"tables/table_{number}.md"].decode()
        assert "borno_8" in text
        assert "mine" in text
    tables = [made.files[name].decode().lower() for name in made.files if name.startswith("tables/")]
    assert not any(re.search(r"\bnan\b|\bnone\b", text) for text in tables)


def test_the_printed_lines_compare_pointnetkl_with_its_rivals(made: report.Report):
    kl = next(line for line in made.lines if line.startswith("borno_8 (simulated): mean KL"))
    assert all(method in kl for method in ("pointnetkl", "constant_train", "naive_gicp"))


def test_the_report_makes_the_files_and_folders_that_dvc_yaml_names(made: report.Report):
    stage = yaml.safe_load((Path(__file__).parents[2] / "dvc.yaml").read_text())["stages"]["report"]
    named = [out if isinstance(out, str) else next(iter(out)) for out in stage["outs"]]
    assert {f"reports/{Path(name).parts[0]}" for name in (*made.files, "models/network.md")} == set(named)


def test_every_method_but_the_labels_own_has_a_page_of_its_worst_submaps(made: report.Report):
    pages = {name.removesuffix(".png") for name in made.files if name.startswith("figures/worst/")}
    assert pages == {f"figures/worst/{name}" for name in fake_artifacts.METHODS if name != "monte_carlo"}
