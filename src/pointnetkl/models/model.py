"""The interface that every kind of model has for training, for its file and for ONNX."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from pointnetkl.models import cholesky
from pointnetkl.models.samples import Samples
from pointnetkl.workflow.errors import PointNetKLError


class ModelError(PointNetKLError):
    """A model is used in a state that would give a wrong answer."""


@dataclass(frozen=True)
class Example:
    """An example of an input, from which ONNX takes its shape."""

    value: Tensor
    free: dict[int, str]  # names of the axes that may have any length


class Model(nn.Module, ABC):
    """A network that answers with [l, d], the numbers of a Cholesky composition of Q, for each of its inputs."""

    settings: Any  # a dataclass with `dimensions`, M: 2 for x, y; 3 with yaw
    describe: Callable[[np.ndarray], np.ndarray] | None = None  # what samples must hold of a submap's points (n, 3)

    @abstractmethod
    def start(self, training: Samples) -> None:
        """Set the untrained model to a sensible answer for submaps like these."""

    @abstractmethod
    def inputs(
        self, samples: Samples, indices: np.ndarray, points: int | None, rng: np.random.Generator
    ) -> tuple[np.ndarray, ...]:
        """Return what `forward` takes, float32, for the submaps at these indices.

        A submap is seen by `points` random points. None: by all of them, and there is one index.
        """

    @abstractmethod
    def example(self) -> dict[str, Example]:
        """Return an example of two submaps for each argument of `forward`, by name, in their order."""


class Covariance(nn.Module):
    """A model that answers with Q itself, for export."""

    def __init__(self, model: Model) -> None:
        """Wrap a model."""
        super().__init__()
        self.model = model

    def forward(self, *inputs: Tensor) -> Tensor:
        """Return Q (B, M, M), in metres and radians, of the model's inputs."""
        return cholesky.covariance(self.model(*inputs), self.model.settings.dimensions)


def predict(model: Model, inputs: tuple[np.ndarray, ...]) -> np.ndarray:
    """Return Q (B, M, M), float64, in metres and radians. Safe to call from threads.

    Raises:
        ModelError: the model is in training mode.
    """
    if model.training:
        raise ModelError("a model in training mode normalises a cloud by its batch; call model.eval() before predict")
    with torch.inference_mode():
        numbers = model(*to_tensors(model, inputs)).double()
        return np.asarray(cholesky.covariance(numbers, model.settings.dimensions).cpu())


def to_tensors(model: Model, inputs: tuple[np.ndarray, ...]) -> tuple[Tensor, ...]:
    """Return inputs as tensors on the model's device."""
    device = next(model.parameters()).device
    return tuple(torch.from_numpy(np.ascontiguousarray(array)).to(device) for array in inputs)
