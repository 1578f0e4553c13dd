"""Two slips of the authors' SLAM program, repeated here so that Table IV can be shown with them and without.

The program whitens an edge's residual by the transpose of the right Cholesky factor, so that it works with another
covariance than it was given; and it leaves out the first loop closure.
"""

import numpy as np

from pointnetkl.slam.graph.pose_graph import Edges


def acting(covariances: np.ndarray) -> np.ndarray:
    """Return the covariances (..., k, k) with which the authors' program works when it is given these.

    With Q^-1 = M M^T, M lower triangular, a residual r should be whitened to M^T r; the program whitens it to M r. The
    covariance of that is (M^T M)^-1. M^-T is the upper triangular U of Q = U U^T, so it equals U^T U: its determinant
    and trace are those of Q, and variance has moved from the first axes to the last. The slip works on the whole noise
    of an edge, whose axes are in the order of `pose`. Where only x and y are correlated (2 dimensions), only their
    block changes; with yaw (3 dimensions) the block of yaw, x and y does, yaw first. A diagonal covariance, as that of
    dead reckoning, stays as it is.
    """
    reversed_ = covariances[..., ::-1, ::-1]
    upper = np.linalg.cholesky(reversed_)[..., ::-1, ::-1]
    return np.asarray(np.swapaxes(upper, -1, -2) @ upper)


def closures(edges: Edges, covariances: np.ndarray) -> tuple[Edges, np.ndarray]:
    """Return the loop closures that the authors' program optimises, and the covariances (e - 1, 6, 6) it works with."""
    return Edges(edges.target[1:], edges.source[1:], edges.T_target_source[1:]), acting(covariances[1:])
