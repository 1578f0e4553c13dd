"""False loop closures: edges between submaps that do not overlap."""

from collections.abc import Sequence

import numpy as np

from pointnetkl.slam.graph.pose_graph import Edges


def counts(true: int, shares: Sequence[float]) -> list[int]:
    """Return the number of false closures that, beside `true` ones, makes up each share of all closures."""
    return [round(true * share / (1 - share)) for share in shares]


def pairs_apart(coverages: np.ndarray) -> np.ndarray:
    """Return the pairs (p, 2) of nodes k and i > k + 1 whose footprints share no cell (loop_gate.coverages)."""
    return np.argwhere(np.triu((coverages == 0) & (coverages.T == 0), 2))


def draw(true: Edges, gt: np.ndarray, pairs: np.ndarray, count: int, rng: np.random.Generator) -> Edges:
    """Return `count` false closures between pairs (p, 2) of nodes apart; a pair repeats only after all have been used.

    They look as the front end makes them: x, y of a true closure, as a registration on wrong ground might find, and
    z, roll, pitch and yaw of GT (n, 4, 4).
    """
    target, source = rng.permutation(pairs)[np.arange(count) % len(pairs)].T
    T_target_source = np.linalg.inv(gt[target]) @ gt[source]
    T_target_source[:, :2, 3] = true.T_target_source[rng.integers(len(true.source), size=count), :2, 3]
    return Edges(target, source, T_target_source)


def join(true: Edges, false: Edges, count: int) -> Edges:
    """Return the true closures, then the first `count` false ones."""
    return Edges(
        target=np.concatenate([true.target, false.target[:count]]),
        source=np.concatenate([true.source, false.source[:count]]),
        T_target_source=np.concatenate([true.T_target_source, false.T_target_source[:count]]),
    )
