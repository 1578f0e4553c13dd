"""Loop closures that are not true: between submaps that do not overlap, and say that they do."""

from collections.abc import Sequence

import numpy as np

from pointnetkl.slam.graph.pose_graph import Edges


def counts(true: int, shares: Sequence[float]) -> list[int]:
    """Return how many false closures beside `true` ones make each share of all that are false."""
    return [round(true * share / (1 - share)) for share in shares]


def pairs_apart(coverages: np.ndarray) -> np.ndarray:
    """Return the pairs (p, 2) of nodes k and i > k + 1 whose footprints share no cell (loop_gate.coverages)."""
    return np.argwhere(np.triu((coverages == 0) & (coverages.T == 0), 2))


def draw(true: Edges, gt: np.ndarray, apart: np.ndarray, count: int, rng: np.random.Generator) -> Edges:
    """Return so many false closures of pairs that lie apart (p, 2), each pair once as long as there are others.

    As the front end makes them: x, y of one true closure, which a registration of wrong ground might have found, and
    z, roll, pitch and yaw of GT (n, 4, 4).
    """
    chosen = rng.permutation(apart)[np.arange(count) % len(apart)]
    target, source = chosen.T
    measured = np.linalg.inv(gt[target]) @ gt[source]
    measured[:, :2, 3] = true.measured[rng.integers(len(true.source), size=count), :2, 3]
    return Edges(target, source, measured)


def joined(true: Edges, false: Edges, count: int) -> Edges:
    """Return the true closures, then the first so many false ones."""
    return Edges(
        target=np.concatenate([true.target, false.target[:count]]),
        source=np.concatenate([true.source, false.source[:count]]),
        measured=np.concatenate([true.measured, false.measured[:count]]),
    )
