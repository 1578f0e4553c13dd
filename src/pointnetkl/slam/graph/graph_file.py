"""A survey's graph from its file, checked whole before anything is computed from it."""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from pointnetkl.slam.graph import survey_graph
from pointnetkl.slam.graph.survey_graph import Closures, SurveyGraph, SurveyGraphError
from pointnetkl.workflow import artifacts

# Kind (numpy's dtype.kind) and shape of the arrays: of n nodes, e edges, r registrations that find m numbers, and
# x rejected ones.
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
_CENTROID = "node_centroid_m"  # only where yaw is found
_COUNTED = {"n": "number", "e": "edge_source", "r": "registration_node", "x": "rejected_node"}


class GraphFile(NamedTuple):
    """A graph, and what it was made with."""

    path: Path
    graph: SurveyGraph
    made_with: Mapping[str, Any]

    def number(self, name: str) -> float:
        """Return a number that the graph was made with, by its dotted name.

        Raises:
            SurveyGraphError: the file does not say it, or what is no number above zero.
        """
        value: Any = self.made_with
        for part in name.split("."):
            value = value.get(part) if isinstance(value, Mapping) else None
        if type(value) not in (int, float) or not 0 < value < math.inf:
            raise SurveyGraphError(f"{self.path}: does not say its {name}; run dvc repro graph@{self.graph.survey}")
        return float(value)


def read(path: Path, survey: str | None = None, dimensions: int | None = None) -> GraphFile:
    """Return the graph of a file: of this survey, and with registrations of M dimensions, where they are given.

    Raises:
        SurveyGraphError: the graph is damaged, or not the one that was meant.
        ArtifactError: the file is missing or damaged.
    """
    arrays, made_with = artifacts.read_arrays(path)
    try:
        _check_arrays(arrays)
        _check_draws(int(arrays["draws"]), made_with)
        graph = survey_graph.from_arrays(arrays)
        for closures in graph.draws:
            _check_draw(closures)
    except ValueError as error:
        raise SurveyGraphError(f"{path}: the graph is damaged: {error}; delete it and run dvc repro") from error
    if survey not in (None, graph.survey):
        raise SurveyGraphError(f"{path}: is of survey {graph.survey}, not of {survey}; give the files of one survey")
    if dimensions not in (None, found := graph.closures.start.shape[1]):
        raise SurveyGraphError(
            f"{path}: its registrations find {found} numbers, and by registration.dof of the parameters they would"
            f" find {dimensions}; run dvc repro graph@{graph.survey}"
        )
    return GraphFile(path, graph, made_with)


def _check_arrays(arrays: Mapping[str, np.ndarray]) -> None:
    if missing := [name for name in _FORMS if name not in arrays]:
        raise ValueError(f"it lacks {missing[0]}")
    sizes = {letter: arrays[name].size for letter, name in _COUNTED.items()}
    sizes["m"] = 3 if _CENTROID in arrays else 2
    for name, (kind, shape) in {**_FORMS, **({_CENTROID: ("f", ("n", 2))} if sizes["m"] == 3 else {})}.items():
        found, due = arrays[name], tuple(sizes.get(str(each), each) for each in shape)
        if (found.dtype.kind, found.shape) != (kind, due):
            raise ValueError(f"{name} has the shape {found.shape} and type {found.dtype}")
        if kind == "f" and name != "truth" and not np.isfinite(found).all():  # a truth may be unknown
            raise ValueError(f"{name} has a number that is not finite")
    _require_below(arrays, int(arrays["draws"]), "edge_draw", "registration_draw", "rejected_draw")
    _require_below(arrays, sizes["n"], "edge_target", "edge_source", "registration_node", "rejected_node")
    if sizes["n"] < 1 or arrays["number"].min() < 0 or len(np.unique(arrays["number"])) < sizes["n"]:
        raise ValueError("it has no submaps, one of a number below 0, or two of one number")


def _check_draws(draws: int, made_with: Mapping[str, Any]) -> None:
    said = made_with.get("graph")
    if draws < 1 or (isinstance(said, Mapping) and said.get("draws", draws) != draws):
        raise ValueError(f"draws is {draws}, and it was not made with so many")


def _require_below(arrays: Mapping[str, np.ndarray], count: int, *names: str) -> None:
    for name in names:
        if not ((arrays[name] >= 0) & (arrays[name] < count)).all():
            raise ValueError(f"{name} is out of its range, 0 to {count - 1}")


def _check_draw(closures: Closures) -> None:
    which, edges = closures.registration, closures.edges
    _require_below({"edge_registration": which}, len(closures.node), "edge_registration")
    if (closures.node[which] != edges.source).any() or (edges.target >= edges.source).any():
        raise ValueError("an edge does not lead from an earlier submap to the one that was registered")
