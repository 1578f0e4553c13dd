"""A graph's file is the graph that was written, or one sentence says what is wrong with it."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pointnetkl.slam.graph import graph_file, survey_graph
from pointnetkl.slam.graph.survey_graph import SurveyGraphError
from pointnetkl.workflow import artifacts
from toy_survey import graph

ARRAYS = survey_graph.to_arrays(graph()[1])
METADATA = {"spacing_m": 0.8, "graph": {"draws": 2, "cell_factor": 5.0}}


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "toy.npz"


def write(path: Path, metadata: dict[str, Any] = METADATA, **spoilt: np.ndarray | None) -> Path:
    """Write the toy graph with some arrays replaced, or without them."""
    arrays = {name: array for name, array in (ARRAYS | spoilt).items() if array is not None}
    artifacts.write_arrays(path, arrays, metadata)
    return path


def with_value(name: str, value: float, index: tuple[int, ...] = (0,)) -> dict[str, np.ndarray]:
    """Return an array of the graph with one number replaced."""
    array = ARRAYS[name].copy()
    array[index] = value
    return {name: array}


def test_a_graph_comes_back_from_its_file_with_its_metadata(path: Path):
    file = graph_file.read(write(path), "toy")
    again = survey_graph.to_arrays(file.graph)
    assert all(np.array_equal(again[name], array, equal_nan=array.dtype.kind == "f") for name, array in ARRAYS.items())
    assert (file.number("spacing_m"), file.number("graph.cell_factor")) == (0.8, 5.0)


def test_the_truth_may_be_unknown(path: Path):
    file = graph_file.read(write(path, truth=np.full_like(ARRAYS["truth"], np.nan)))
    assert np.isnan(file.graph.truth).all()


@pytest.mark.parametrize(
    ("spoilt", "says"),
    [
        (with_value("gt", np.nan, (3, 0, 3)), "gt has a number that is not finite"),
        (with_value("edge_measured", np.nan, (0, 0, 3)), "edge_measured has a number that is not finite"),
        ({"gt": ARRAYS["gt"][:-2]}, "gt has the shape"),
        ({"gt": np.array("elsewhere")}, "gt has the shape"),
        ({"gt": None}, "it lacks gt"),
        ({"draws": np.array(0)}, "draws is 0|_draw is out of its range"),
        ({"draws": np.array(99)}, "draws is 99, which does not agree with its metadata"),
        ({"draws": np.array("two")}, "draws has the shape"),
        (with_value("closure_sigmas", -1.0), "roll_rad is -1"),
        ({"dead_reckoning_sigmas": np.ones(5)}, "dead_reckoning_sigmas has the shape"),
        (with_value("edge_target", 999), "edge_target is out of its range, 0 to 11"),
        (with_value("registration_node", -1), "registration_node is out of its range"),
        ({"edge_source": ARRAYS["edge_source"][:-1]}, "has the shape"),
        ({"number": np.zeros_like(ARRAYS["number"])}, "two of one number"),
        ({"number": ARRAYS["number"].astype(float)}, "number has the shape"),
        ({"edge_registration": ARRAYS["edge_registration"] - 1}, "edge_registration is out of its range"),
        ({"edge_registration": np.zeros_like(ARRAYS["edge_registration"])}, "an edge does not lead from an earlier"),
        ({"edge_target": ARRAYS["edge_source"]}, "an edge does not lead from an earlier"),
        ({"node_centroid_m": np.zeros((12, 2))}, "registration_start_m has the shape"),
    ],
)
def test_what_is_no_graph_is_told_in_a_sentence(path: Path, spoilt: dict[str, Any], says: str):
    with pytest.raises(SurveyGraphError, match=f"toy.npz: the graph is damaged: .*({says})"):
        graph_file.read(write(path, **spoilt))


def test_another_graph_than_was_meant_is_refused(path: Path):
    write(path)
    with pytest.raises(SurveyGraphError, match="is of survey toy, not of baltic"):
        graph_file.read(path, "baltic")


@pytest.mark.parametrize("metadata", [{}, {"graph": 5}, {"graph": {"cell_factor": "5"}}, {"graph": {"cell_factor": 0}}])
def test_a_number_of_the_metadata_is_a_number_or_a_sentence(path: Path, metadata: dict[str, Any]):
    with pytest.raises(
        SurveyGraphError, match=r"toy\.npz: does not say its graph\.cell_factor; run dvc repro graph@toy"
    ):
        graph_file.read(write(path, metadata)).number("graph.cell_factor")
