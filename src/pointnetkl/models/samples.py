"""Submaps with their labels, as models learn from them: canonical clouds and Monte Carlo covariances."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Samples:
    """Submaps to learn from: equal indices are one submap."""

    survey: np.ndarray  # (k,) names
    submap: np.ndarray  # (k,) int32, ascending within a survey, which is their order along its track
    clouds: list[np.ndarray]  # k of (n, 3) float32, canonical
    radius: np.ndarray  # (k,) metres
    label: np.ndarray  # (k, M, M) m^2
    described: np.ndarray | None = None  # (k, D) float32, of the submaps' own points, where a model asks for it

    def __len__(self) -> int:
        """Return the number of submaps."""
        return len(self.clouds)

    def take(self, indices: np.ndarray) -> "Samples":
        """Return the submaps at the given indices."""
        clouds = [self.clouds[i] for i in indices]
        described = None if self.described is None else self.described[indices]
        return Samples(
            self.survey[indices], self.submap[indices], clouds, self.radius[indices], self.label[indices], described
        )

    def draw(self, indices: np.ndarray, points: int | None, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        """Return as many random points of each cloud (b, points, 3), float32, and the radii (b,), float32.

        A point comes twice only where the cloud has fewer: nothing is padded, so no batch norm sees what is not
        there. None: all points, of clouds that have the same number of them.
        """
        clouds = [self.clouds[i] for i in indices]
        if points is not None:
            clouds = [c[rng.choice(len(c), points, replace=len(c) < points, shuffle=False)] for c in clouds]
        return np.stack(clouds), self.radius[indices].astype(np.float32)
