"""The arrays that the paper's authors publish (`data/consolidated/*.npy`): submaps and labels of their own surveys.

A row is a submap: its points, zero-mean, scaled into the unit sphere and then voxelised; the covariance that its
registrations started with (prior) and the one they ended with (posterior, the label), m^2, both in the frame of the
authors' submaps, which is that of the points but for scale; rho, the sphere's radius in metres; the names of the two
files that it was made from. Rows follow the track, one folder of files after another.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pointnetkl.authors import object_array
from pointnetkl.models.samples import Samples
from pointnetkl.registration.covariance import gaussian
from pointnetkl.surveys import voxel
from pointnetkl.workflow.errors import PointNetKLError

# What the authors' files are in Tables I and II. Of a test survey they have two: `slam` with the submaps that they
# discarded, `val` without; the paper does not say which one Table II is of.
SURVEYS = {
    "antarctica": "antarctica_7",
    "antarctica_slam": "thwaites_11",
    "antarctica_val": "thwaites_11",
    "baltic": "baltic",
    "borno": "borno_1",
    "borno_slam": "borno_8",
    "borno_val": "borno_8",
    "shetland": "shetland",
}
PRIOR_M2 = 9.0  # a of Sigma_sample = a I (section V-A of the paper)
VOXEL = 0.05  # of the authors' script; the paper says 0.01

_COLUMNS = 6
_LARGEST_M = 1e5  # no submap is as large
_SLACK = 1e-3  # of a norm on the unit sphere: rounding
_FARTHEST = 0.5  # a voxel's mean lies farther out than this, for the farthest point lies at 1
_ROUNDING = 1e-5  # of the texts of some digits that the covariances came from: their halves may differ by it
_PRIOR_SLACK = 0.1  # of its variance: what a few hundred registrations sample


class ConsolidatedError(PointNetKLError):
    """A row of the authors' arrays is not one, or files do not go together."""


@dataclass(frozen=True)
class Consolidated:
    """The submaps of one file, in its order: equal indices are one submap."""

    clouds: voxel.Clouds  # their numbers are those of the rows
    label: np.ndarray  # (k, 2, 2) m^2
    prior: np.ndarray  # (k, 2, 2) m^2
    files: list[tuple[str, str]]  # of its points, and of its covariances

    def __len__(self) -> int:
        """Return the number of submaps."""
        return len(self.clouds)

    def prior_note(self) -> str:
        """Return a sentence where a prior is not the paper's 9 I m^2, and nothing where all of them are."""
        away = np.abs(self.prior - PRIOR_M2 * np.eye(2)).max(axis=(1, 2))
        if not (unlike := int(np.sum(away > _PRIOR_SLACK * PRIOR_M2))):
            return ""
        worst = self.prior[int(away.argmax())].tolist()
        return f"{unlike} of {len(self)} priors are not the paper's {PRIOR_M2:g} I m^2, the farthest is {worst}"


def read(path: Path) -> Consolidated:
    """Read a file of the authors', every row checked; nothing in it is executed.

    Raises:
        ObjectArrayError: the file is missing, damaged or no array of rows.
        ConsolidatedError: a row is not of the form above.
        CovarianceError: a prior or a label is not a covariance.
    """
    clouds, labels, priors, files = [], [], [], []
    spent = 0
    for number, row in enumerate(object_array.rows(path, _COLUMNS)):
        origin = f"{path}, row {number}"
        points, prior, label, rho, *names = row
        clouds.append(voxel.Canonical(_points(points, origin), _radius(rho, origin)))
        # rows may share an array, which is stored once: copies of it could take any memory
        if (spent := spent + points.nbytes) > path.stat().st_size:
            raise ConsolidatedError(f"{origin}: its points were those of rows before; take the file that was published")
        priors.append(_covariance(prior, f"{origin}, prior"))
        labels.append(_covariance(label, f"{origin}, posterior"))
        files.append(_names(names, origin))
    if not clouds:
        raise ConsolidatedError(f"{path}: has no rows; take the file that was published")
    return Consolidated(voxel.Clouds.of(range(len(clouds)), clouds), np.stack(labels), np.stack(priors), files)


def samples(every: Mapping[str, Consolidated]) -> Samples:
    """Return the submaps of all files as the network learns them; each file is a survey, with its key for a name."""
    return Samples(
        np.repeat(list(every), [len(each) for each in every.values()]),
        np.concatenate([each.clouds.submap for each in every.values()]),
        [each.clouds.cloud(i).points for each in every.values() for i in range(len(each))],
        np.concatenate([each.clouds.radius for each in every.values()]),
        np.concatenate([each.label for each in every.values()]),
    )


def check_unseen(test: Consolidated, training: Consolidated, names: Sequence[object]) -> None:
    """Refuse, naming both files, to test on a submap that is trained on: one of the same radius and label.

    Raises:
        ConsolidatedError: there is one.
    """
    known = {fingerprint: row for row, fingerprint in enumerate(_fingerprints(training))}
    for number, fingerprint in enumerate(_fingerprints(test)):
        if fingerprint in known:
            raise ConsolidatedError(
                f"{names[0]}, row {number}: is row {known[fingerprint]} of {names[1]}, which is trained on;"
                " test on other submaps"
            )


def _fingerprints(every: Consolidated) -> list[tuple[float, bytes]]:
    return [(float(r), q.tobytes()) for r, q in zip(every.clouds.radius, every.label, strict=True)]


def _points(points: Any, origin: str) -> np.ndarray:
    if not _is_real(points) or points.ndim != 2 or points.shape[1] != 3 or not len(points):
        raise ConsolidatedError(f"{origin}: its points are {_form(points)}, must be numbers of shape (n, 3)")
    with np.errstate(over="ignore"):
        farthest = float(np.linalg.norm(points, axis=1).max())
    if not _FARTHEST <= farthest <= 1 + _SLACK:
        raise ConsolidatedError(
            f"{origin}: its farthest point is at {farthest:.4g}, must be at 1, for points scaled into the unit sphere"
        )
    return points.astype(np.float32)


def _covariance(q: Any, origin: str) -> np.ndarray:
    if not _is_real(q) or q.shape != (2, 2):
        raise ConsolidatedError(f"{origin}: is {_form(q)}, must be numbers of shape (2, 2)")
    whole = q.astype(np.float64)
    if not np.abs(whole - whole.T).max() > _ROUNDING * np.abs(whole).max():  # also where it is NaN
        whole = (whole + whole.T) / 2
    if (largest := float(np.abs(whole).max())) > _LARGEST_M**2:
        raise ConsolidatedError(f"{origin}: has an entry of {largest:.3g} m^2, which no registration has")
    return gaussian.check(whole, origin)


def _radius(rho: Any, origin: str) -> float:
    value = rho.item() if isinstance(rho, np.ndarray) and rho.size == 1 else rho
    if type(value) not in (int, float) or not 0 < value < _LARGEST_M:
        raise ConsolidatedError(f"{origin}: rho is {_form(value)}, must be a radius above 0 and below {_LARGEST_M:g} m")
    return float(value)


def _names(names: Sequence[Any], origin: str) -> tuple[str, str]:
    if not all(type(name) is str for name in names):
        raise ConsolidatedError(f"{origin}: its last two cells are not the names of files")
    return names[0], names[1]


def _is_real(array: Any) -> bool:
    return isinstance(array, np.ndarray) and array.dtype.kind in "fiu"


def _form(value: Any) -> str:
    """Return what a cell is, in a few words: to print what a file made up can take all memory."""
    if isinstance(value, np.ndarray):
        return f"{value.dtype} of shape {value.shape}"
    return f"{value:g}" if type(value) is float else f"of type {type(value).__name__}"
