"""All products of a correction together, and what is left out of which survey."""

import dataclasses
from pathlib import Path

import pytest

import corrected_survey
from pointnetkl.correction import products
from pointnetkl.correction.result import Corrected
from pointnetkl.slam.graph.pose_graph import DeadReckoningNoise
from pointnetkl.surveys.survey import POINTS
from pointnetkl.workflow.artifacts import ArtifactError

NOISE = [DeadReckoningNoise(1e-3, 1e-3, 0.02, 0.5, 0.3, 0.01)] * 8
PLACED = {"navigation.sbet", "navigation.smrmsg", "navigation.fnv", "first.all.na0", "second.all.na0", "ties.txt"}
ANYWHERE = {"closures.csv", "track.csv", "trajectory.tum", "lines.gpkg", "covariances.txt"}


def written(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_a_survey_with_times_on_the_earth_has_all_products(tmp_path: Path):
    sentences = products.write(tmp_path, corrected_survey.corrected(heads=2), NOISE)
    assert set(written(tmp_path)) == PLACED | ANYWHERE | {"graph.g2o"}
    assert [sentence.split()[:2] for sentence in sentences] == [["ties.txt", "lacks"], ["graph.g2o", "lacks"]]


def test_a_local_survey_lacks_what_needs_a_place_and_says_so(tmp_path: Path):
    sentences = products.write(tmp_path, corrected_survey.corrected("local"))
    assert set(written(tmp_path)) == ANYWHERE
    assert "no SBET and no SMRMSG: the survey has no place on the earth" in sentences
    assert "no graph.g2o: the noise of dead reckoning is not known" in sentences


def test_points_have_closures_alone(tmp_path: Path):
    survey = corrected_survey.without_closures()
    points = dataclasses.replace(survey, kind=POINTS, track=survey.track.iloc[:0], submaps=None)
    sentences = products.write(tmp_path, points, NOISE)
    assert set(written(tmp_path)) == {"closures.csv"}
    assert len(sentences) == 3


def test_submaps_of_another_program_have_no_products_with_times(tmp_path: Path):
    products.write(tmp_path, corrected_survey.of_submaps(), NOISE)
    assert set(written(tmp_path)) == ANYWHERE | {"graph.g2o"}


@pytest.mark.parametrize("applied", [True, False])
def test_the_same_survey_gives_the_same_bytes(tmp_path: Path, applied: bool):
    folders = [tmp_path / name for name in "ab"]
    for folder in folders:
        folder.mkdir()
        products.write(folder, corrected_survey.corrected(applied=applied), NOISE)
    assert written(folders[0]) == written(folders[1])


def test_a_track_left_as_it_was_has_equal_places_before_and_after(tmp_path: Path):
    survey: Corrected = corrected_survey.corrected(applied=False)
    products.write(tmp_path, survey)
    assert survey.rms_moved_m == 0
    assert (tmp_path / "track.csv").exists()


def test_a_folder_that_cannot_be_written_is_an_error_of_ours(tmp_path: Path):
    (tmp_path / "file").write_text("")
    with pytest.raises(ArtifactError, match="cannot be written"):
        products.write(tmp_path / "file", corrected_survey.corrected())
