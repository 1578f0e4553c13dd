"""The methods that learn a few numbers from training labels; a new method is added by a line in LEARNERS."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from pointnetkl.methods.closed_forms.self_registration import SelfRegistration
from pointnetkl.methods.fitted import calibrated, cello, constant, fitting, structure_tensor
from pointnetkl.registration import gicp, monte_carlo
from pointnetkl.registration.covariance import catalogue
from pointnetkl.registration.covariance.method import Method
from pointnetkl.workflow import artifacts, parameters
from pointnetkl.workflow.parameters import require_seed


class Learner(Protocol):
    """What a learned method offers: the names of its numbers, their fit to training labels, and the method of a fit."""

    def names(self, dimensions: int) -> tuple[str, ...]:
        """Return the names of the numbers, for covariances (M, M)."""

    def fit(self, training: fitting.Training, settings: fitting.Settings) -> fitting.Fit:
        """Return the numbers with the least mean KL to the training labels."""

    def from_fit(self, name: str, fit: fitting.Fit, setup: SelfRegistration) -> Method:
        """Return the method of a fit."""


LEARNERS: dict[str, Learner] = {
    catalogue.CONSTANT_TRAIN: constant,
    catalogue.HESSIAN_CALIBRATED: calibrated.HESSIAN,
    catalogue.CENSI_CALIBRATED: calibrated.CENSI,
    catalogue.STRUCTURE_TENSOR: structure_tensor,
    catalogue.CELLO: cello,
}


@dataclass(frozen=True)
class Settings:
    """Section `predict` of the parameters."""

    seed: int  # of the noisy copies that closed forms look at

    def __post_init__(self) -> None:
        """Refuse values out of their range."""
        require_seed(self.seed)


@dataclass(frozen=True)
class Fits:
    """The fits of every method, and the training submaps and labels behind them."""

    fits: dict[str, fitting.Fit]
    submaps: int  # of the training surveys
    label: monte_carlo.Settings  # of the training labels, as is the next
    registration: gicp.Settings


def fit(training: fitting.Training, settings: fitting.Settings) -> Fits:
    """Return every method's fit to the training labels."""
    fits = {name: learner.fit(training, settings) for name, learner in LEARNERS.items()}
    return Fits(fits, len(training.submaps), training.setup.label, training.setup.registration)


def methods(fits: Fits, seed: int) -> list[Method]:
    """Return the methods that the fits define; closed forms draw the noise of their copies from the seed."""
    setup = SelfRegistration(seed, fits.label, fits.registration)
    return [learner.from_fit(name, fits.fits[name], setup) for name, learner in LEARNERS.items()]


def write(path: Path, fits: Fits, made_with: Mapping[str, Any]) -> None:
    """Write fits as JSON, with the parameters that made them; a line for each row that a method remembers."""
    entries = {name: _entry(fit) for name, fit in fits.fits.items()}
    sections = {"label": fits.label, "registration": fits.registration}
    params = {**made_with, **{name: parameters.as_metadata(settings) for name, settings in sections.items()}}
    artifacts.write_json(path, {**entries, "submaps": fits.submaps, "params": params})


def read(path: Path) -> Fits:
    """Read fits, and the settings of the labels that they are fitted to.

    Raises:
        ArtifactError: the file is missing or is not JSON.
        FittingError: a method or one of its numbers is missing, or is not a finite number.
        SettingsError: the file does not say which labels the methods were fitted to.
    """
    content = artifacts.read_json(path)
    made_with = content.get("params", {})
    label = parameters.from_metadata(made_with, "label", monte_carlo.Settings, path)
    registration = parameters.from_metadata(made_with, "registration", gicp.Settings, path)
    fits = {name: _read_fit(path, name, content, registration.dimensions) for name in LEARNERS}
    if not isinstance(submaps := content.get("submaps"), int):
        raise fitting.FittingError(f"{path}: lacks the number of submaps; run dvc repro fit")
    return Fits(fits, submaps, label, registration)


def _entry(fit: fitting.Fit) -> dict[str, Any]:
    rows = [" ".join(f"{number:.6g}" for number in row) for row in fit.rows]
    return {**fit.numbers, "mean_kl": fit.mean_kl} | ({"rows": rows} if rows else {})


def _read_fit(path: Path, name: str, content: Mapping[str, Any], dimensions: int) -> fitting.Fit:
    entry = content.get(name)
    if not isinstance(entry, dict):
        raise fitting.FittingError(f"{path}: has no fit of {name}; run dvc repro fit")
    names = LEARNERS[name].names(dimensions)
    for key in (*names, "mean_kl"):
        if not (isinstance(value := entry.get(key), int | float) and math.isfinite(value)):
            raise fitting.FittingError(f"{path}: {name}.{key} is {value!r}, must be a number; run dvc repro fit")
    numbers = {key: float(entry[key]) for key in names}
    return fitting.Fit(numbers, float(entry["mean_kl"]), _read_rows(path, name, entry.get("rows", [])))


def _read_rows(path: Path, name: str, lines: Any) -> tuple[tuple[float, ...], ...]:
    try:
        rows = tuple(tuple(map(float, line.split())) for line in lines)
    except (AttributeError, TypeError, ValueError) as error:
        raise fitting.FittingError(f"{path}: {name}.rows has a line without numbers; run dvc repro fit") from error
    if len({len(row) for row in rows}) > 1 or not all(math.isfinite(number) for row in rows for number in row):
        raise fitting.FittingError(f"{path}: {name}.rows has a line with a gap; run dvc repro fit")
    return rows
