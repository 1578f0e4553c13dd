"""Reads a survey's graph from its file, and checks all of it before anything is computed."""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from pointnetkl.slam.graph import survey_graph
from pointnetkl.slam.graph.survey_graph import Closures, SurveyGraph, SurveyGraphError
from pointnetkl.workflow import artifacts

# Kind (numpy's dtype.kind) and shape of the arrays, for n nodes, e edges, r registrations in m dimensions and x
# rejected registrations.
_POSES = ("f", ("n", 4, 4))
_FORMS: Mapping[str, tuple[str, tuple[str | int, ...]]] = {
    **{"survey": ("U", ()), "draws": ("i", ()), "number": ("i", ("n",))},
    **{"navigation": _POSES, "gt": _POSES, "truth": _POSES},
    **{"dead_reckoning_sigmas": ("f", (6,)), "closure_sigmas": ("f", (4,))},
    **dict.fromkeys(("edge_source", "edge_target", "edge_registration", "edge_draw"), ("i", ("e",))),
    "edge_measured": ("f", ("e", 4, 4)),
    **dict.fromkeys(("registration_node", "registration_draw"), ("i", ("r",))),
    **dict.fromkeys(("registration_start_m", "registration_correction_m"), ("f", ("r", "m"))),
    "registration_converged": ("b", ("r",)),
    **dict.fromkeys(("rejected_node", "rejected_draw"), ("i", ("x",))),
}
_CENTROID = "node_centroid_m"  # only where registrations find yaw
_COUNTED = {"n": "number", "e": "edge_source", "r": "registration_node", "x": "rejected_node"}


class GraphFile(NamedTuple):
    """A graph, and its metadata: the settings that it was made with."""

    path: Path
    graph: SurveyGraph
    metadata: Mapping[str, Any]

    def number(self, name: str) -> float:
        """Return a number of the metadata by its dotted name.

        Raises:
            SurveyGraphError: the metadata lacks it, or it is not a number above zero.
        """
        value: Any = self.metadata
        for part in name.split("."):
            value = value.get(part) if isinstance(value, Mapping) else None
        if type(value) not in (int, float) or not 0 < value < math.inf:
            raise SurveyGraphError(f"{self.path}: does not say its {name}; run dvc repro graph@{self.graph.survey}")
        return float(value)


def read(path: Path, survey: str | None = None) -> GraphFile:
    """Return the graph of a file, which must be of the survey, if one is given.

    Raises:
        SurveyGraphError: the graph is damaged, or of another survey.
        ArtifactError: the file is missing or damaged.
    """
    arrays, metadata = artifacts.read_arrays(path)
    try:
        _check_arrays(arrays)
        _check_draws(int(arrays["draws"]), metadata)
        graph = survey_graph.from_arrays(arrays)
        for closures in graph.draws:
            _check_draw(closures)
    except ValueError as error:
        raise SurveyGraphError(f"{path}: the graph is damaged: {error}; delete it and run dvc repro") from error
    if survey not in (None, graph.survey):
        raise SurveyGraphError(f"{path}: is of survey {graph.survey}, not of {survey}; give the files of one survey")
    return GraphFile(path, graph, metadata)


def _check_arrays(arrays: Mapping[str, np.ndarray]) -> None:
    if missing := [name for name in _FORMS if name not in arrays]:
        raise ValueError(f"it lacks {missing[0]}")
    sizes = {letter: arrays[name].size for letter, name in _COUNTED.items()}
    sizes["m"] = 3 if _CENTROID in arrays else 2
    for name, (kind, shape) in {**_FORMS, **({_CENTROID: ("f", ("n", 2))} if sizes["m"] == 3 else {})}.items():
        array, expected = arrays[name], tuple(sizes.get(str(size), size) for size in shape)
        if (array.dtype.kind, array.shape) != (kind, expected):
            raise ValueError(f"{name} has the shape {array.shape} and type {array.dtype}")
        if kind == "f" and name != "truth" and not np.isfinite(array).all():  # a truth may be unknown
            raise ValueError(f"{name} has a number that is not finite")
    _require_below(arrays, int(arrays["draws"]), "edge_draw", "registration_draw", "rejected_draw")
    _require_below(arrays, sizes["n"], "edge_target", "edge_source", "registration_node", "rejected_node")
    if sizes["n"] < 1 or arrays["number"].min() < 0 or len(np.unique(arrays["number"])) < sizes["n"]:
        raise ValueError("it has no submaps, one of a number below 0, or two of one number")


def _check_draws(draws: int, metadata: Mapping[str, Any]) -> None:
    settings = metadata.get("graph")
    if draws < 1 or (isinstance(settings, Mapping) and settings.get("draws", draws) != draws):
        raise ValueError(f"draws is {draws}, which does not agree with its metadata")


def _require_below(arrays: Mapping[str, np.ndarray], count: int, *names: str) -> None:
    for name in names:
        if not ((arrays[name] >= 0) & (arrays[name] < count)).all():
            raise ValueError(f"{name} is out of its range, 0 to {count - 1}")


def _check_draw(closures: Closures) -> None:
    registration, edges = closures.registration, closures.edges
    _require_below({"edge_registration": registration}, len(closures.node), "edge_registration")
    if (closures.node[registration] != edges.source).any() or (edges.target >= edges.source).any():
        raise ValueError("an edge does not lead from an earlier submap to the registered one")
