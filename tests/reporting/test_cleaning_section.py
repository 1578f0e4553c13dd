"""What was cleaned out of a survey stands in the report, in the words and numbers of the stages that did it."""

import pandas as pd
import pytest

import fake_artifacts
import whole_survey
from pointnetkl import segmentation
from pointnetkl.readers import georeference
from pointnetkl.reporting import text_table
from pointnetkl.reporting.results import Folders
from pointnetkl.reporting.surveys import tables as survey_tables
from pointnetkl.reporting.surveys import words as survey_words
from pointnetkl.reporting.text_table import Block
from pointnetkl.workflow import study
from small_survey import sail

DATASETS = {name: {"simulated": name != "mine"} for name in (*fake_artifacts.TRAIN, *fake_artifacts.TEST)}


@pytest.fixture(scope="module")
def blocks(tmp_path_factory: pytest.TempPathFactory) -> list[Block]:
    """The tables of a made-up study."""
    root = tmp_path_factory.mktemp("fake")
    fake_artifacts.write(root)
    return survey_tables.cleaning(
        survey_tables.read(Folders(root / "data", root, root, study.read(root / "params.yaml"))), DATASETS
    )


def test_every_survey_has_a_row_also_those_that_are_only_trained_on(blocks: list[Block]):
    assert list(blocks[0].frame["survey"]) == list(DATASETS)


def test_what_was_read_is_what_was_left_out_and_flagged_and_what_is_valid(blocks: list[Block]):
    for row in blocks[0].frame.to_dict("records"):
        assert row["pings_left_out"] == 2
        flagged = row["rejected"] + row["impossible"] + row["outliers"]
        assert row["soundings"] == row["soundings_left_out"] + flagged + row["valid"]
        assert (row["alone"], row["on_turns"], row["in_ends"], row["submaps"]) == (4, 25, 6, 18)


def test_every_reason_is_named_and_none_that_left_nothing_out(blocks: list[Block]):
    reasons = blocks[1].frame[blocks[1].frame["survey"] == "mine"].set_index("left_out")["count"]
    assert reasons["pings that stand twice"] == 2
    assert reasons["outliers: soundings that disagree with their neighbours"] == 3
    assert reasons["pings in ends of lines"] == 6
    assert (reasons > 0).all()


def test_the_words_are_those_of_the_stages():
    one = sail()
    found = whole_survey.cut(
        segmentation.segment, "small", one.pings, [one.soundings], 100.0, 4.0, segmentation.Settings(1, 30.0)
    )
    assert set(survey_tables.DROPPED.values()) <= set(found.dropped)
    assert set(georeference.FLAGS) <= set(survey_tables.cleaning({}, {})[0].frame)


def test_what_an_artifact_does_not_tell_is_a_dash():
    of = {"ingest": {}, "segment": {}, "pings": 0, "submaps": 3}
    blocks = survey_tables.cleaning({"mine": of}, DATASETS)
    row = pd.Series(blocks[0].frame.iloc[0])
    assert row["submaps"] == 3
    assert row["pings_left_out"] is None
    assert text_table.UNKNOWN in text_table.markdown(blocks)


def test_the_section_explains_every_column(blocks: list[Block]):
    words = " ".join(survey_words.cleaning({"cleaning": blocks}).paragraphs)
    plain = {"survey", "simulated", "pings", "soundings", "soundings_left_out", "submaps", "submaps_left_out"}
    assert all(name in words for name in set(blocks[0].frame) - plain)
