"""The methods that learn a few numbers from training labels: a new one joins by a line in LEARNERS."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from pointnetkl import artifacts, gicp
from pointnetkl.covariance import constant, fitting, structure_tensor
from pointnetkl.covariance.method import Method


class Learner(Protocol):
    """What a module must offer to be learned: its numbers' names, the fit, and the method of fitted numbers."""

    NUMBERS: tuple[str, ...]

    def fit(self, training: fitting.Training, settings: fitting.Settings) -> fitting.Fit:
        """Return the numbers with the least mean KL to the training labels."""

    def from_numbers(self, name: str, numbers: Mapping[str, float], registration: gicp.Settings) -> Method:
        """Return the method of fitted numbers."""


LEARNERS: dict[str, Learner] = {"constant_train": constant, "structure_tensor": structure_tensor}


@dataclass(frozen=True)
class Fits:
    """What every method learned, from how many submaps."""

    fits: dict[str, fitting.Fit]
    submaps: int


def fit(training: fitting.Training, settings: fitting.Settings) -> Fits:
    """Return every method's fit to the training labels."""
    fits = {name: learner.fit(training, settings) for name, learner in LEARNERS.items()}
    return Fits(fits, len(training.submaps))


def methods(fits: Fits, registration: gicp.Settings) -> list[Method]:
    """Return the methods that the fits define."""
    return [learner.from_numbers(name, fits.fits[name].numbers, registration) for name, learner in LEARNERS.items()]


def write(path: Path, fits: Fits, parameters: Mapping[str, Any]) -> None:
    """Write fits as JSON, with the parameters that made them."""
    entries = {name: {**each.numbers, "mean_kl": each.mean_kl} for name, each in fits.fits.items()}
    artifacts.write_json(path, {**entries, "submaps": fits.submaps, "params": parameters})


def read(path: Path) -> Fits:
    """Read fits.

    Raises:
        ArtifactError: the file is missing or is not JSON.
        FittingError: a method or one of its numbers is missing, or is not a finite number.
    """
    content = artifacts.read_json(path)
    fits = {name: _read_fit(path, name, content) for name in LEARNERS}
    if not isinstance(submaps := content.get("submaps"), int):
        raise fitting.FittingError(f"{path}: lacks the number of submaps; run dvc repro fit")
    return Fits(fits, submaps)


def _read_fit(path: Path, name: str, content: Mapping[str, Any]) -> fitting.Fit:
    entry = content.get(name)
    if not isinstance(entry, dict):
        raise fitting.FittingError(f"{path}: has no fit of {name}; run dvc repro fit")
    for key in (*LEARNERS[name].NUMBERS, "mean_kl"):
        if not (isinstance(value := entry.get(key), int | float) and math.isfinite(value)):
            raise fitting.FittingError(f"{path}: {name}.{key} is {value!r}, must be a number; run dvc repro fit")
    return fitting.Fit({key: float(entry[key]) for key in LEARNERS[name].NUMBERS}, float(entry["mean_kl"]))
