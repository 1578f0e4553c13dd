"""Whether a submap is like those that a model was trained on. Where it is not, the model's covariance is a guess.

A few numbers, the traits, describe a submap's points; none depends on where the submap lies or how it is turned. Their
Mahalanobis distance to the training submaps is compared with a limit. The limit comes from surveys that had no part in
the mean and the covariance.
"""

import dataclasses
from dataclasses import dataclass

import numpy as np

_SLACK = 0.1  # a tenth more or less of a length or a count is nothing new, though all training submaps be alike
_QUANTILE = 0.99  # of a survey's submaps that the limit lets pass
_BLOCK = 3.0  # point spacings: the edge of the cells within which ground counts as rough
# metres that make flat ground's logarithms finite; smaller differences matter to no registration
_RELIEF_M, _ROUGH_M, _TILT = 0.1, 0.05, 0.01


@dataclass(frozen=True)
class TraitDistribution:
    """Mean and covariance of the traits of the training submaps, and the distance up to which a submap is like them."""

    centre: np.ndarray  # (T,) mean
    whitening: np.ndarray  # (T, T): (traits - centre) @ whitening has unit covariance
    limit: float  # of the distance; beyond it a submap is new

    def distance(self, traits: np.ndarray) -> np.ndarray:
        """Return the root mean square of whitened traits (..., T): 1 is usual."""
        return np.asarray(np.sqrt(np.mean(((traits - self.centre) @ self.whitening) ** 2, axis=-1)))

    def novelty(self, points: np.ndarray) -> float:
        """Return the distance of a submap's points (n, 3), metres, as a share of the limit: above 1 it is new."""
        return float(self.distance(traits(points)) / self.limit)


def traits(points: np.ndarray) -> np.ndarray:
    """Return logarithms (8,) of what a submap's points (n, 3), metres, are like, in any frame with z up.

    Their number, their extent along and across, how much of it they cover, relief, tilt, roughness and how far the
    farthest point stands out of it.
    """
    centred = points - points.mean(axis=0)
    xy, z = centred[:, :2], centred[:, 2]
    moments, axes = np.linalg.eigh(xy.T @ xy / len(xy))
    moments = np.maximum(moments, 1e-6)
    tilt = (axes / moments) @ axes.T @ (xy.T @ z) / len(z)
    residual = z - xy @ tilt
    area = 12 * np.sqrt(moments.prod())  # of a rectangle with these moments
    edge = _BLOCK * np.sqrt(area / len(z))
    rough, cells = _above_cells(xy @ axes, residual, edge)
    return np.log(
        [
            len(z),
            *np.sqrt(moments),
            cells / len(z),
            residual.std() + _RELIEF_M,
            np.hypot(*tilt) + _TILT,
            rough.std() + _ROUGH_M,
            (np.abs(rough).max() + _RELIEF_M) / (rough.std() + _ROUGH_M),
        ]
    )


def learn(seen: np.ndarray, survey: np.ndarray) -> TraitDistribution:
    """Return what is known by traits (k, T) of training submaps, in the order of their surveys' tracks.

    Each survey (k,) in turn is judged by the others; the limit is the median over surveys of the distance that all but
    1 % of a survey stay below. A single survey is judged by its halves.
    """
    groups = survey if len(set(survey)) > 1 else np.arange(len(seen)) * 2 // len(seen)
    others = ((_around(seen[groups != name]), seen[groups == name]) for name in np.unique(groups))
    limits = [np.quantile(distribution.distance(left_out), _QUANTILE) for distribution, left_out in others]
    return dataclasses.replace(_around(seen), limit=float(np.median(limits)))


def _above_cells(xy: np.ndarray, height: np.ndarray, edge: float) -> tuple[np.ndarray, int]:
    """Return heights (n,) above the mean of their square cell, and the number of cells."""
    corner = np.floor((xy - xy.min(axis=0)) / edge).astype(np.int64)
    key = corner[:, 0] * (corner[:, 1].max() + 1) + corner[:, 1]
    # cells by their names and not in a raster, because one stray point would make it a large one
    _, cell, counts = np.unique(key, return_inverse=True, return_counts=True)
    return height - (np.bincount(cell, height) / counts)[cell], len(counts)


def _around(seen: np.ndarray) -> TraitDistribution:
    """Return mean and whitening of traits (k, T), no limit set."""
    centre = seen.mean(axis=0)
    covariance = (seen - centre).T @ (seen - centre) / len(seen) + _SLACK**2 * np.eye(len(centre))
    variances, axes = np.linalg.eigh(covariance)
    return TraitDistribution(centre, axes / np.sqrt(variances), np.inf)
