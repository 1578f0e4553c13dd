"""The front end's loop gate: the pairs of submaps that it joined, and the pairs that really cover each other."""

from collections.abc import Sequence

import numpy as np
import pandas as pd
from scipy import sparse

from pointnetkl.slam.graph import footprint
from pointnetkl.slam.graph.pose_graph import Edges
from pointnetkl.slam.graph.survey_graph import SurveyGraph
from pointnetkl.slam.robust import schemas
from pointnetkl.surveys import pose


def coverages(clouds: Sequence[np.ndarray], poses: np.ndarray, cell: float) -> np.ndarray:
    """Return (n, n): the share of submap i's footprint that submap k's has too.

    `clouds` (n_i, 3) are in submap frames, `poses` (n, 4, 4) are T_map_submap, `cell` is the size of the cells, metres.
    """
    cells = [footprint.cells(pose.transform(T, points), cell) for T, points in zip(poses, clouds, strict=True)]
    counts = np.array([len(keys) for keys in cells])
    _, column = np.unique(np.concatenate(cells), return_inverse=True)
    row = np.repeat(np.arange(len(cells)), counts)
    occupied = sparse.csr_array((np.ones(len(row), np.int64), (row, column)))
    return np.asarray((occupied @ occupied.T).toarray() / counts[:, None])


def table(
    graph: SurveyGraph, clouds: Sequence[np.ndarray], corrupted: Sequence[np.ndarray], cell: float, coverage: float
) -> pd.DataFrame:
    """Return the gate's counts (schemas.GATE) for pairs of which the earlier covers `coverage` of the later.

    Rows are for the graph's loop closures, which Algorithm 1 found at GT as it corrected it, and for pairs that cover
    as much at poses that nothing has corrected: navigation's, and corrupted ones (each n, 4, 4).
    """
    covering = None if np.isnan(graph.truth).any() else _covering(clouds, graph.truth, cell, coverage)
    tried = [(schemas.GRAPH, draw, _joined(closures.edges, len(clouds))) for draw, closures in enumerate(graph.draws)]
    tried.append((schemas.NAVIGATION, 0, _covering(clouds, graph.navigation, cell, coverage)))
    tried += [(schemas.CORRUPTED, i, _covering(clouds, T, cell, coverage)) for i, T in enumerate(corrupted)]
    rows = [
        {"survey": graph.survey, "at": poses, "draw": draw, **_counts(joined, covering)}
        for poses, draw, joined in tried
    ]
    return pd.DataFrame(rows, columns=schemas.GATE.names)


def _covering(clouds: Sequence[np.ndarray], poses: np.ndarray, cell: float, coverage: float) -> np.ndarray:
    """Return (n, n): whether the gate lets pair i, k pass; k = i - 1 never passes."""
    return np.tril(coverages(clouds, poses, cell) >= coverage, -2)


def _joined(edges: Edges, n: int) -> np.ndarray:
    joined = np.zeros((n, n), bool)
    joined[edges.source, edges.target] = True
    return joined


def _counts(joined: np.ndarray, covering: np.ndarray | None) -> dict[str, float]:
    if covering is None:
        return {"joined": joined.sum(), "covering": np.nan, "both": np.nan}
    return {"joined": joined.sum(), "covering": float(covering.sum()), "both": float((joined & covering).sum())}
