"""The page beside a model's weights says what it was made from."""

import pytest
from test_estimator import KINDS, model

from pointnetkl.reporting import model_card
from pointnetkl.workflow.study import StudySurvey
from toy_submaps import LABEL, REGISTRATION, WITH_YAW

LINE = StudySurvey("data/raw/mine", "data/none", 100.0, 3.2, 200)
SUMMARY = {
    "submaps": {"training": 40, "validation": 10},
    "kl": {"training": 0.06, "validation": 0.07},
    "kl_floor0": {"training": 0.3, "validation": 0.4},
    "flagged": {"training": 0.0, "validation": 0.025},
    "floor_m2": 0.01,
}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("dimensions", [2, 3])
def test_a_card_names_data_labels_units_measures_and_limits(kind: str, dimensions: int):
    registration = REGISTRATION if dimensions == 2 else WITH_YAW
    origin = model_card.Origin({"mine": LINE}, {"mine": 50}, LABEL, registration)
    text = model_card.text("m", kind, model(kind, dimensions), 0.01, origin, SUMMARY)
    assert "| mine | `data/raw/mine` | 50 | 100 | 3.2 | 200 |" in text
    assert all(
        said in text
        for said in ("dvc repro train@m", "N(0, 9 m²)", "0.1 m on each", "| validation | 10 | 0.07 | 0.4 |")
    )
    assert all(
        said in text for said in (f"({dimensions}, {dimensions})", "0 % of the training", "2.5 % of the validation")
    )
    assert ("rad²" in text) == (dimensions == 3)
    inputs = model(kind, dimensions).example()
    assert all(f"`{name}` (clouds" in text for name in inputs)
