"""Two slips of the authors' SLAM program, repeated so that Table IV can be shown both ways.

It whitens an edge's residual by the transpose of the Cholesky factor that it should take, so that another covariance
acts than was given; and it leaves out the first loop closure.
"""

import numpy as np

from pointnetkl.slam.graph.pose_graph import Edges


def acting(covariances: np.ndarray) -> np.ndarray:
    """Return the covariances (..., k, k) that act in the authors' program where these are given.

    With Q^-1 = M M^T, M lower triangular, a residual r should be whitened to M^T r, and is to M r. What acts is
    (M^T M)^-1, and as M^-T is the upper triangular U of Q = U U^T, that is U^T U: of the same determinant and trace,
    with variance moved from the first axes to the last. The slip works on the whole noise of an edge, whose axes are
    in the order of `pose`. Where x and y are correlated with each other alone (M = 2), only their block changes; with
    yaw (M = 3) that of yaw, x and y does, yaw first. A diagonal covariance, as dead reckoning's, stays as it is.
    """
    turned = covariances[..., ::-1, ::-1]
    upper = np.linalg.cholesky(turned)[..., ::-1, ::-1]
    return np.asarray(np.swapaxes(upper, -1, -2) @ upper)


def closures(edges: Edges, covariances: np.ndarray) -> tuple[Edges, np.ndarray]:
    """Return the loop closures that the authors' program optimises, and the covariances (e - 1, 6, 6) that act."""
    return Edges(edges.target[1:], edges.source[1:], edges.measured[1:]), acting(covariances[1:])
