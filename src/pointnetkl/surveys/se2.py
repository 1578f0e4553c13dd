"""SE(2): rigid motions of the plane.

A motion takes p to R(yaw) p + translation, with yaw counter-clockwise. `T_map_submap` takes coordinates from the
submap's frame to the map's: names are read right to left, and so is the product, `T_map_b @ T_b_a`.
"""

from dataclasses import dataclass

import numpy as np


def rotate(vectors: np.ndarray, yaw: np.ndarray | float) -> np.ndarray:
    """Return vectors (..., 2) rotated by yaw (...), radians counter-clockwise."""
    c, s = np.cos(yaw), np.sin(yaw)
    x, y = vectors[..., 0], vectors[..., 1]
    return np.stack([c * x - s * y, s * x + c * y], axis=-1)


@dataclass(frozen=True, eq=False)
class SE2:
    """One motion of the plane, or an array of them; the shapes of both fields broadcast as NumPy's do.

    A yaw of exactly 0 leaves the coordinates that it rotates as they are, bit for bit.
    """

    translation: np.ndarray  # (..., 2) metres
    yaw: np.ndarray | float  # (...) radians, not wrapped

    @classmethod
    def identity(cls) -> "SE2":
        """Return the motion that moves nothing."""
        return cls(np.zeros(2), 0.0)

    @classmethod
    def from_vector(cls, vector: np.ndarray) -> "SE2":
        """Return the motion with translation x, y and yaw of a vector (..., 3), metres and radians."""
        return cls(vector[..., :2], vector[..., 2])

    @classmethod
    def from_matrix(cls, T: np.ndarray) -> "SE2":
        """Return the part in the plane, x, y and yaw, of transforms (..., 4, 4)."""
        return cls(T[..., :2, 3], np.arctan2(T[..., 1, 0], T[..., 0, 0]))

    @classmethod
    def exp(cls, tangent: np.ndarray) -> "SE2":
        """Return the motion of a tangent vector (..., 3): x, y, yaw, metres and radians."""
        half = tangent[..., 2] / 2
        # V = sinc(yaw / 2) R(yaw / 2); NumPy's sinc(u) is sin(pi u) / (pi u)
        translation = np.sinc(half / np.pi)[..., None] * rotate(tangent[..., :2], half)
        return cls(translation, tangent[..., 2])

    def log(self) -> np.ndarray:
        """Return the tangent vector (..., 3), x, y, yaw, whose `exp` this motion is; yaw must be within (-pi, pi)."""
        half = np.asarray(self.yaw / 2)
        # V^-1; without a turn sinc makes it the identity
        diagonal = np.cos(half) / np.sinc(half / np.pi)
        x, y = self.translation[..., 0], self.translation[..., 1]
        return np.stack([diagonal * x + half * y, diagonal * y - half * x, np.asarray(self.yaw)], axis=-1)

    def __matmul__(self, first: "SE2") -> "SE2":
        """Return the motion that is `first`, and then this one."""
        return SE2(self.act(first.translation), self.yaw + first.yaw)

    def __truediv__(self, first: "SE2") -> "SE2":
        """Return `self @ first.inverse()`, the motion that after `first` makes this one, by a single rotation."""
        yaw = self.yaw - first.yaw
        return SE2(self.translation - rotate(first.translation, yaw), yaw)

    def inverse(self) -> "SE2":
        """Return the motion that undoes this one."""
        return SE2(-rotate(self.translation, -self.yaw), -self.yaw)

    def from_centre(self, centre: np.ndarray) -> "SE2":
        """Return, about the origin, the motion that this one is about a centre (..., 2): p -> R (p - c) + c + t."""
        return SE2(self.translation + (centre - rotate(centre, self.yaw)), self.yaw)

    def act(self, points: np.ndarray) -> np.ndarray:
        """Return points (..., 2), or (..., 3) whose z stays, after the motion."""
        plane = rotate(points[..., :2], self.yaw) + self.translation
        return plane if points.shape[-1] == 2 else np.concatenate([plane, points[..., 2:]], axis=-1)

    def act_on_pose(self, T: np.ndarray) -> np.ndarray:
        """Return a pose (4, 4) after the motion: `to_matrix() @ T`."""
        moved = T.copy()
        moved[:2] = rotate(T[:2].T, self.yaw).T
        moved[:2, 3] += self.translation
        return moved

    def adjoint(self) -> np.ndarray:
        """Return the matrix (..., 3, 3) of tangent vectors from frame to frame: T exp(v) T^-1 = exp(Ad v)."""
        yaw = np.broadcast_to(self.yaw, self.translation.shape[:-1])
        c, s = np.cos(yaw), np.sin(yaw)
        matrix = np.zeros((*yaw.shape, 3, 3)) + np.eye(3)
        matrix[..., 0, 0], matrix[..., 0, 1], matrix[..., 1, 0], matrix[..., 1, 1] = c, -s, s, c
        matrix[..., :2, 2] = self.translation[..., ::-1] * [1, -1]
        return matrix

    def to_vector(self) -> np.ndarray:
        """Return x, y, yaw as a vector (..., 3), metres and radians."""
        return np.concatenate([self.translation, np.asarray(self.yaw)[..., None]], axis=-1)

    def to_matrix(self) -> np.ndarray:
        """Return the transform (..., 4, 4), which leaves z as it is."""
        c, s = np.cos(self.yaw), np.sin(self.yaw)
        T = np.zeros((*np.shape(self.yaw), 4, 4)) + np.eye(4)
        T[..., 0, 0], T[..., 0, 1], T[..., 1, 0], T[..., 1, 1] = c, -s, s, c
        T[..., :2, 3] = self.translation
        return T
