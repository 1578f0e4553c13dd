"""What is believed of a survey's poses, and what a loop closure tells of them.

Poses are x, y (metres, axes of the map) and yaw (radians) of n submaps; z, roll and pitch are measured and stay. A
belief is Gaussian with one covariance (3 n, 3 n), so that constant errors of navigation are in it and the variance of
any submap on any others can be read off.
"""

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import sparse

from pointnetkl.surveys.se2 import SE2, rotate
from pointnetkl.workflow.errors import PointNetKLError


class ClosingError(PointNetKLError):
    """A survey cannot be closed."""


@dataclass(frozen=True)
class Estimate:
    """Poses of n submaps, and how sure they are.

    Raises:
        ClosingError: the covariance is not of these poses.
    """

    poses: np.ndarray  # (n, 3) x, y, yaw
    covariance: np.ndarray  # (3 n, 3 n) m^2 and rad^2

    def __post_init__(self) -> None:
        """Refuse a covariance of another size."""
        size = 3 * len(self.poses)
        if self.poses.shape != (len(self.poses), 3) or self.covariance.shape != (size, size):
            raise ClosingError(
                f"poses are {self.poses.shape} and their covariance {self.covariance.shape}, must be (n, 3) and"
                " (3 n, 3 n)"
            )

    @property
    def marginals(self) -> np.ndarray:
        """Return the covariances (n, 3, 3) of each pose."""
        n = len(self.poses)
        return np.array(self.covariance.reshape(n, 3, n, 3)[np.arange(n), :, np.arange(n)])


@dataclass(frozen=True)
class Tie:
    """A source among targets, as they lay when they were tied: its offset is how far poses have moved it since.

    The offset (2,) is that of the point `lever` of the source, in metres, in the axes of the targets at that time,
    against where it lay. With several targets it is a mean. Without any it is tied to the map itself.
    """

    source: int
    targets: Sequence[int]
    shares: np.ndarray  # (k,) of each target in the mean, with a sum of 1
    lever: np.ndarray  # (2,) metres, in the source's frame
    tied: np.ndarray  # (k, 3) poses of the targets at the time
    tied_source: np.ndarray  # (3,) and of the source

    @classmethod
    def at(
        cls, poses: np.ndarray, source: int, targets: Sequence[int], shares: np.ndarray | None, lever: np.ndarray
    ) -> "Tie":
        """Return the tie of a source at poses (n, 3); without shares all targets count the same."""
        shares = np.full(len(targets), 1 / len(targets)) if shares is None else shares
        return cls(source, targets, shares, lever, poses[list(targets)].copy(), poses[source].copy())

    def offset(self, poses: np.ndarray) -> np.ndarray:
        """Return the offset (2,) at poses (n, 3)."""
        moved = _point(poses[self.source], self.lever)
        if not len(self.targets):
            return np.asarray(moved - _point(self.tied_source, self.lever))
        places = [
            tied[:2] + rotate(moved - now[:2], tied[2] - now[2])
            for tied, now in zip(self.tied, poses[list(self.targets)], strict=True)
        ]
        return np.asarray(self.shares @ np.array(places) - _point(self.tied_source, self.lever))

    def jacobian(self, poses: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the columns (3 k + 3,) of the source's pose and its targets', and the offset's slopes by them."""
        at = poses[self.source]
        arm = rotate(self.lever, at[2])
        moved, blocks = at[:2] + arm, [np.zeros((2, 3))]
        if not len(self.targets):
            return 3 * self.source + np.arange(3), np.column_stack([np.eye(2), _crosswise(arm)])
        for share, tied, k in zip(self.shares, self.tied, self.targets, strict=True):
            turn = tied[2] - poses[k, 2]
            R = rotate(np.eye(2), turn).T
            blocks[0] = blocks[0] + share * R @ np.column_stack([np.eye(2), _crosswise(arm)])
            back = R @ (moved - poses[k, :2])
            blocks.append(-share * np.column_stack([R, _crosswise(back)]))
        columns = 3 * np.array([self.source, *self.targets])[:, None] + np.arange(3)
        return columns.ravel(), np.hstack(blocks)

    def variance(self, estimate: Estimate) -> np.ndarray:
        """Return the covariance (2, 2), m^2, of the offset: how sure an estimate is of the source on its targets."""
        columns, J = self.jacobian(estimate.poses)
        return np.asarray(J @ estimate.covariance[np.ix_(columns, columns)] @ J.T)


@dataclass(frozen=True)
class Closure:
    """A loop closure: what the ground tells of a source among its targets; rank 0 to 2, of unit variance."""

    tie: Tie
    A: np.ndarray  # (rank, 2) 1/m
    c: np.ndarray  # (rank,)
    residual_variance: float  # s^2 of its matches, m^2
    end: np.ndarray  # (2,) offset at which the search ended, metres
    points: int = 0  # of the source over its targets, which were registered

    @property
    def rank(self) -> int:
        """Return how many directions the ground holds."""
        return len(self.c)

    def residual(self, poses: np.ndarray) -> np.ndarray:
        """Return A offset - c (rank,) at poses (n, 3)."""
        return np.asarray(self.A @ self.tie.offset(poses) - self.c)

    def with_covariance(self, Q: np.ndarray) -> "Closure":
        """Return the closure of the same end whose offset is said to have a covariance Q (2, 2), m^2, axes of the map.

        Raises:
            ClosingError: Q is not positive definite.
        """
        try:
            A = np.linalg.inv(np.linalg.cholesky(Q))
        except np.linalg.LinAlgError as error:
            raise ClosingError(f"a covariance of a loop closure is {Q.tolist()}, must be positive definite") from error
        return dataclasses.replace(self, A=A, c=A @ self.end)


def linearised(closures: Sequence[Closure], poses: np.ndarray) -> tuple[sparse.csr_array, np.ndarray]:
    """Return the slopes (m, 3 n), and the residuals (m,) of all closures at poses (n, 3)."""
    rows, columns, values, first = [], [], [], 0
    for closure in closures:
        column, J = closure.tie.jacobian(poses)
        slopes = closure.A @ J
        rows.append(np.repeat(np.arange(first, first + closure.rank), len(column)))
        columns.append(np.tile(column, closure.rank))
        values.append(slopes.ravel())
        first += closure.rank
    if not first:
        return sparse.csr_array((0, 3 * len(poses))), np.zeros(0)
    entries = np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))
    residuals = np.concatenate([closure.residual(poses) for closure in closures])
    return sparse.csr_array(entries, shape=(first, 3 * len(poses))), residuals


def from_matrices(poses: np.ndarray) -> np.ndarray:
    """Return x, y and yaw (n, 3) of poses (n, 4, 4), with a yaw that does not jump."""
    plane = SE2.from_matrix(poses).to_vector()
    plane[:, 2] = np.unwrap(plane[:, 2])
    return plane


def to_matrices(plane: np.ndarray, like: np.ndarray) -> np.ndarray:
    """Return poses (n, 4, 4) at x, y and yaw (n, 3), with the z, roll and pitch of other poses (n, 4, 4)."""
    moved = like.copy()
    turn = plane[:, 2] - np.arctan2(like[:, 1, 0], like[:, 0, 0])
    moved[:, :2, :3] = rotate(np.swapaxes(like[:, :2, :3], 1, 2), turn[:, None]).swapaxes(1, 2)
    moved[:, :2, 3] = plane[:, :2]
    return moved


def _point(at: np.ndarray, lever: np.ndarray) -> np.ndarray:
    return np.asarray(at[:2] + rotate(lever, at[2]))


def _crosswise(v: np.ndarray) -> np.ndarray:
    return np.array([-v[1], v[0]])
