"""The training set: read whole or not at all, split so that neighbours stay together."""

from pathlib import Path

import numpy as np
import pytest

from pointnetkl.models.samples import Samples
from pointnetkl.registration.covariance import gaussian
from pointnetkl.training import dataset
from pointnetkl.workflow import artifacts, parameters
from toy_submaps import LABEL, REGISTRATION
from training_surveys import MADE_WITH, write


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    write(tmp_path, "baltic", 20)
    write(tmp_path, "shetland", 30)
    return tmp_path


def numbers(samples: Samples, survey: str) -> np.ndarray:
    return samples.submap[samples.survey == survey]


def test_surveys_are_joined_in_the_order_of_their_names(folder: Path):
    samples, edge = dataset.read(folder, ["shetland", "baltic"])
    assert (len(samples), edge) == (50, 0.01)
    assert list(dict.fromkeys(samples.survey)) == ["shetland", "baltic"]
    assert samples.label[30 + 4].tolist() == [[2.0, 0.1], [0.1, 5.0]]
    assert (len(samples.clouds[34]), samples.radius[34]) == (34, 104.0)


@pytest.mark.parametrize("file", ["clouds.npz", "labels.parquet"])
def test_a_missing_file_is_named_with_the_command_that_makes_it(folder: Path, file: str):
    (folder / "shetland" / file).unlink()
    with pytest.raises(dataset.DatasetError, match=rf"shetland/{file}: is missing.*run dvc repro"):
        dataset.read(folder, ["baltic", "shetland"])


def test_labels_of_other_submaps_are_refused(folder: Path):
    write(folder, "other", 20, first=1)
    (folder / "other/labels.parquet").replace(folder / "baltic/labels.parquet")
    with pytest.raises(dataset.DatasetError, match=r"baltic: clouds\.npz has 20 submaps, not those of the 20 labels"):
        dataset.read(folder, ["baltic"])


def test_surveys_of_different_voxels_are_not_mixed(folder: Path):
    write(folder, "coarse", 20, edge=0.05)
    with pytest.raises(dataset.DatasetError, match=r"coarse: voxels of 0\.05, but baltic has 0\.01"):
        dataset.read(folder, ["baltic", "coarse"])


def test_a_label_that_is_no_covariance_is_refused(folder: Path):
    labels = artifacts.read_table(folder / "baltic/labels.parquet", dataset.LABEL)
    labels.loc[3, "q_xy_m2"] = 50.0
    artifacts.write_table(folder / "baltic/labels.parquet", labels, dataset.LABEL, {})
    with pytest.raises(gaussian.CovarianceError, match="submap 3"):
        dataset.read(folder, ["baltic"])


def test_nothing_to_train_on_is_an_error(folder: Path):
    with pytest.raises(dataset.DatasetError, match=r"study\.train names no survey"):
        dataset.read(folder, [])


def test_validation_is_a_fifth_of_every_survey_in_blocks_along_the_track(folder: Path):
    training, validation = dataset.split(dataset.read(folder, ["baltic", "shetland"])[0], 0.2, 2, seed=0)
    assert len(training) + len(validation) == 50
    for survey, size in (("baltic", 4), ("shetland", 6)):
        held_back = numbers(validation, survey)
        assert len(held_back) == size
        assert not set(held_back) & set(numbers(training, survey))
        # two blocks of consecutive submaps: inside one, both neighbours are held back as well
        assert (np.diff(held_back) > 1).sum() <= 1


def test_the_same_seed_splits_the_same_and_another_survey_changes_nothing(folder: Path):
    both = dataset.split(dataset.read(folder, ["baltic", "shetland"])[0], 0.2, 2, seed=5)[1]
    alone = dataset.split(dataset.read(folder, ["shetland"])[0], 0.2, 2, seed=5)[1]
    np.testing.assert_array_equal(numbers(both, "shetland"), alone.submap)
    others = [dataset.split(dataset.read(folder, ["shetland"])[0], 0.2, 2, seed=s)[1].submap for s in range(9)]
    assert len({tuple(o) for o in others}) > 1


@pytest.mark.parametrize("count", [2, 3, 7, 12, 100])
@pytest.mark.parametrize("share", [0.2, 0.5, 0.8])
def test_any_survey_of_two_submaps_or_more_can_be_split(tmp_path: Path, count: int, share: float):
    write(tmp_path, "small", count)
    training, validation = dataset.split(dataset.read(tmp_path, ["small"])[0], share, 3, seed=1)
    assert len(training) + len(validation) == count
    assert min(len(training), len(validation)) >= 1
    assert abs(len(validation) - share * count) <= 1


def test_a_survey_of_one_submap_cannot_be_split(tmp_path: Path):
    write(tmp_path, "tiny", 1)
    with pytest.raises(dataset.DatasetError, match="tiny: has 1 submap, too few"):
        dataset.split(dataset.read(tmp_path, ["tiny"])[0], 0.2, 2, seed=0)


def test_points_are_drawn_twice_only_where_there_are_too_few(folder: Path):
    samples = dataset.read(folder, ["baltic"])[0]
    points, radius = samples.draw(np.array([0, 19]), 35, np.random.default_rng(0))
    assert (points.shape, radius.tolist()) == ((2, 35, 3), [100.0, 119.0])
    for cloud, drawn, distinct in ((samples.clouds[0], points[0], 30), (samples.clouds[19], points[1], 35)):
        assert {tuple(p) for p in drawn} <= {tuple(p) for p in cloud}
        assert len({tuple(p) for p in drawn}) <= distinct
    assert len({tuple(p) for p in points[1]}) == 35


def relabel(folder: Path, metadata: dict[str, dict[str, object]]) -> None:
    """Write a survey's labels anew, as if they were made with other parameters."""
    labels = artifacts.read_table(folder / "labels.parquet", dataset.LABEL)
    artifacts.write_table(folder / "labels.parquet", labels, dataset.LABEL, metadata)


def test_the_labels_say_with_which_settings_they_were_made(folder: Path):
    relabel(folder / "shetland", {**MADE_WITH, "label": {**MADE_WITH["label"], "seed": 9}})  # which changes no Q
    assert dataset.made_with(folder, ["baltic", "shetland"]) == (LABEL, REGISTRATION)


def test_labels_of_two_kinds_are_refused(folder: Path):
    relabel(folder / "shetland", {**MADE_WITH, "label": {**MADE_WITH["label"], "noise_sigma_m": 0.4}})
    said = r"shetland/labels\.parquet: was made with label\.noise_sigma_m 0\.4, but .*baltic/labels\.parquet with 0\.1"
    with pytest.raises(dataset.DatasetError, match=said):
        dataset.made_with(folder, ["baltic", "shetland"])


def test_labels_of_unknown_settings_are_refused(folder: Path):
    relabel(folder / "baltic", {})
    with pytest.raises(parameters.SettingsError, match=r"baltic/labels\.parquet: does not say with which label"):
        dataset.made_with(folder, ["baltic", "shetland"])
