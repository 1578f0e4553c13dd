"""A trained model as a method: it predicts the covariance from the submap alone."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from pointnetkl.models import model, model_file
from pointnetkl.models.model_file import Stored
from pointnetkl.registration import gicp, monte_carlo
from pointnetkl.surveys import voxel
from pointnetkl.surveys.submap import Submap
from pointnetkl.workflow import parameters
from pointnetkl.workflow.errors import PointNetKLError

_DECIDE_LABELS = ("copy", "noise_sigma_m", "prior_variance_m2")  # of section `label`: another value makes another Q


class TrainedError(PointNetKLError):
    """A model was trained for another covariance than is asked for."""


@dataclass(frozen=True)
class Trained:
    """A trained model; its file's name is the method's name."""

    name: str
    stored: Stored

    def covariance(self, submap: Submap) -> np.ndarray:
        """Return Q, (M, M) in m^2 and radians, in the submap's frame.

        Raises:
            VoxelError, MeanFieldError: the submap has no extent, or a coordinate that is not a number.
        """
        origin = f"{submap.survey}, submap {submap.number}"
        return model.predict(self.stored.model, inputs(self.stored, submap.points, origin))[0]


def inputs(stored: Stored, points: np.ndarray, origin: str) -> tuple[np.ndarray, ...]:
    """Return the inputs of a stored model for one submap's points (n, 3), metres: every preprocessing step.

    Raises:
        VoxelError, MeanFieldError: as Trained.covariance; VoxelError begins with `origin`.
    """
    if describe := stored.model.describe:
        return (describe(points)[None],)
    cloud = voxel.canonical(points, stored.voxel, origin)
    return cloud.points[None], np.array([cloud.radius], np.float32)


def differences(
    metadata: Mapping[str, Any], label: monte_carlo.Settings, registration: gicp.Settings
) -> Iterator[tuple[str, Any, Any]]:
    """Yield each setting that decides Q and is another in metadata than in these settings: name, value there, here.

    What the metadata do not say does not differ.
    """
    for section, settings in (("label", label), ("registration", registration)):
        there, here = metadata.get(section, {}), parameters.as_metadata(settings)
        for key in _DECIDE_LABELS if section == "label" else here:
            if key in there and there[key] != here[key]:
                yield f"{section}.{key}", there[key], here[key]


def check(path: Path, stored: Stored, label: monte_carlo.Settings, registration: gicp.Settings) -> None:
    """Refuse a file's model that learned another Q than these settings have, as far as its file says.

    Raises:
        TrainedError: it has other dimensions, or its labels were made with other settings.
    """
    dof = "xyyaw" if stored.model.settings.dimensions == 3 else "xy"
    wrong = [("registration.dof", dof, registration.dof)] if dof != registration.dof else []
    for setting, value, wanted in (*wrong, *differences(stored.metadata, label, registration)):
        raise TrainedError(
            f"{path}: was trained with {setting} {value}, and {wanted} is asked for; run dvc repro train@{path.stem}"
        )


def load_all(paths: Sequence[Path], label: monte_carlo.Settings, registration: gicp.Settings) -> list[Trained]:
    """Read trained models for the covariances of these settings.

    Raises:
        ModelFileError, TrainedError: as load and check.
    """
    models = {path: load(path) for path in paths}
    for path, loaded in models.items():
        check(path, loaded.stored, label, registration)
    return list(models.values())


def load(path: Path) -> Trained:
    """Read a trained model, and give torch one thread: submaps run in parallel, and sums keep their order.

    Raises:
        ModelFileError: the file is missing, damaged or holds something else.
    """
    stored = model_file.read(path)
    torch.set_num_threads(1)
    return Trained(path.stem, stored)
