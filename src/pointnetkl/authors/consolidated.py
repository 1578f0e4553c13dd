"""The arrays that the paper's authors publish (`data/consolidated/*.npy`): submaps and labels of their own surveys.

A row is a submap: its points, zero-mean, scaled into the unit sphere and then voxelised; the covariances of its
registrations' starts (prior) and of their results (posterior, the label), m^2, both in the frame of the authors'
submaps, which is that of the points without their scale; rho, the sphere's radius in metres; and the names of the two
source files. Rows follow the track, one folder of files after another.
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

# Surveys of the authors' files in Tables I and II. A test survey has two files: `slam` with the submaps that they
# discarded, `val` without them. The paper does not say which one Table II is for.
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
VOXEL = 0.05  # as in the authors' script; the paper says 0.01

_COLUMNS = 6
_LARGEST_M = 1e5  # no submap is so large
_SLACK = 1e-3  # of a norm on the unit sphere: rounding
_FARTHEST = 0.5  # least distance of the farthest voxel mean, because the farthest point is at 1
_ROUNDING = 1e-5  # relative asymmetry of covariances, which were stored as texts of a few digits
_PRIOR_SLACK = 0.1  # relative error of a prior's variance from a few hundred samples


class ConsolidatedError(PointNetKLError):
    """A row of the authors' arrays is not a submap, or two files share a submap."""


@dataclass(frozen=True)
class Consolidated:
    """The submaps of one file in its order; equal indices are of one submap."""

    clouds: voxel.Clouds  # numbered by row
    label: np.ndarray  # (k, 2, 2) m^2
    prior: np.ndarray  # (k, 2, 2) m^2
    files: list[tuple[str, str]]  # of its points, and of its covariances

    def __len__(self) -> int:
        """Return the number of submaps."""
        return len(self.clouds)

    def prior_note(self) -> str:
        """Return a sentence if a prior is not the paper's 9 I m^2, else an empty text."""
        deviation = np.abs(self.prior - PRIOR_M2 * np.eye(2)).max(axis=(1, 2))
        if not (unlike := int(np.sum(deviation > _PRIOR_SLACK * PRIOR_M2))):
            return ""
        worst = self.prior[int(deviation.argmax())].tolist()
        return f"{unlike} of {len(self)} priors are not the paper's {PRIOR_M2:g} I m^2, the farthest is {worst}"


def read(path: Path) -> Consolidated:
    """Read one of the authors' files and check every row; nothing in the file is executed.

    Raises:
        ObjectArrayError: the file is missing or damaged, or is no array of rows.
        ConsolidatedError: a row does not have the form that the module describes.
        CovarianceError: a prior or a label is not a covariance.
    """
    clouds, labels, priors, files = [], [], [], []
    spent = 0
    for number, row in enumerate(object_array.rows(path, _COLUMNS)):
        origin = f"{path}, row {number}"
        points, prior, label, rho, *names = row
        clouds.append(voxel.Canonical(_points(points, origin), _radius(rho, origin)))
        # rows may share an array that is stored once, and copies of it could take any memory
        if (spent := spent + points.nbytes) > path.stat().st_size:
            raise ConsolidatedError(f"{origin}: its points were those of rows before; take the file that was published")
        priors.append(_covariance(prior, f"{origin}, prior"))
        labels.append(_covariance(label, f"{origin}, posterior"))
        files.append(_names(names, origin))
    if not clouds:
        raise ConsolidatedError(f"{path}: has no rows; take the file that was published")
    return Consolidated(voxel.Clouds.join(range(len(clouds)), clouds), np.stack(labels), np.stack(priors), files)


def samples(files: Mapping[str, Consolidated]) -> Samples:
    """Return the submaps of all files as samples for the network; each key is the name of a survey."""
    return Samples(
        np.repeat(list(files), [len(file) for file in files.values()]),
        np.concatenate([file.clouds.submap for file in files.values()]),
        [file.clouds.cloud(i).points for file in files.values() for i in range(len(file))],
        np.concatenate([file.clouds.radius for file in files.values()]),
        np.concatenate([file.label for file in files.values()]),
    )


def check_unseen(test: Consolidated, training: Consolidated, names: Sequence[object]) -> None:
    """Refuse to test on a training submap, which is one with the same radius and label; `names` are of both files.

    Raises:
        ConsolidatedError: there is such a submap.
    """
    training_rows = {fingerprint: row for row, fingerprint in enumerate(_fingerprints(training))}
    for number, fingerprint in enumerate(_fingerprints(test)):
        if fingerprint in training_rows:
            raise ConsolidatedError(
                f"{names[0]}, row {number}: is row {training_rows[fingerprint]} of {names[1]}, which is trained on;"
                " test on other submaps"
            )


def _fingerprints(file: Consolidated) -> list[tuple[float, bytes]]:
    return [(float(radius), q.tobytes()) for radius, q in zip(file.clouds.radius, file.label, strict=True)]


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
    covariance = q.astype(np.float64)
    if not np.abs(covariance - covariance.T).max() > _ROUNDING * np.abs(covariance).max():  # also where it is NaN
        covariance = (covariance + covariance.T) / 2
    if (largest := float(np.abs(covariance).max())) > _LARGEST_M**2:
        raise ConsolidatedError(f"{origin}: has an entry of {largest:.3g} m^2, which no registration has")
    return gaussian.check(covariance, origin)


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


def _form(cell: Any) -> str:
    """Return a cell's type in a few words, because the text of a hostile cell can take all memory."""
    if isinstance(cell, np.ndarray):
        return f"{cell.dtype} of shape {cell.shape}"
    return f"{cell:g}" if type(cell) is float else f"of type {type(cell).__name__}"
