"""A model's card says what the model was made from, and only what its training says."""

from pathlib import Path
from typing import Any

import pytest

import toy_models
from pointnetkl.reporting import model_card
from pointnetkl.workflow import artifacts, parameters
from pointnetkl.workflow.study import StudySurvey
from toy_submaps import LABEL, REGISTRATION, WITH_YAW

LINE = StudySurvey("train", "data/raw/mine", "data/none", 100.0, 3.2, 200)


def summary(kind: str = "pointnetkl", dimensions: int = 2) -> dict[str, Any]:
    """Return what stage train writes of a model."""
    registration = REGISTRATION if dimensions == 2 else WITH_YAW
    settings = {"label": LABEL, "registration": registration}
    return {
        "submaps": {"training": 40, "validation": 10},
        "kl": {"training": 0.06, "validation": 0.07},
        "kl_floor0": {"training": 0.3, "validation": 0.4},
        "flagged": {"training": 0.0, "validation": 0.025},
        "floor_m2": 0.01,
        "model": {"kind": kind, "weights": 123, "dimensions": dimensions, "voxel": 0.01},
        "labels": {"submaps": {"mine": 50}, **{name: parameters.as_metadata(each) for name, each in settings.items()}},
    }


@pytest.mark.parametrize("kind", toy_models.KINDS)
@pytest.mark.parametrize("dimensions", [2, 3])
def test_a_card_names_data_labels_units_measures_and_limits(kind: str, dimensions: int):
    text = model_card.text("m", summary(kind, dimensions), {"mine": LINE})
    assert "| mine | `data/raw/mine` | 50 | 100 | 3.2 | 200 |" in text
    assert f"`{kind}`, 123 weights" in text
    assert all(
        said in text
        for said in ("dvc repro train@m", "N(0, 9 m²)", "0.1 m on each", "| validation | 10 | 0.07 | 0.4 |")
    )
    assert all(
        said in text for said in (f"({dimensions}, {dimensions})", "0 % of the training", "2.5 % of the validation")
    )
    assert ("rad²" in text) == (dimensions == 3)
    inputs = toy_models.model(kind, dimensions).example()
    assert all(f"`{name}` (clouds" in text for name in inputs)


def test_a_summary_that_lacks_a_part_is_refused_with_the_command_that_makes_it(tmp_path: Path):
    artifacts.write_json(tmp_path / "m.json", {name: part for name, part in summary().items() if name != "model"})
    with pytest.raises(model_card.ModelCardError, match=r"m\.json: has no model; run dvc repro train@m"):
        model_card.read(tmp_path / "m.json")


def test_a_model_of_other_surveys_gets_no_card():
    with pytest.raises(model_card.ModelCardError, match=r"m: was trained on mine, unlike study\.train"):
        model_card.text("m", summary(), {"mine": LINE, "other": LINE})
