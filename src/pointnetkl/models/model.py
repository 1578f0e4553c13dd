"""What training, a model's file and ONNX ask of a network, of whatever kind it is."""

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
    """A model is used in a way that would give a wrong answer."""


@dataclass(frozen=True)
class Example:
    """An input as ONNX is shown it."""

    value: Tensor
    free: dict[int, str]  # axes whose length may be any


class Model(nn.Module, ABC):
    """A network that answers with [l, d], the numbers of a Cholesky composition of Q, for each of its inputs."""

    settings: Any  # a dataclass with `dimensions`, M: 2 for x, y; 3 with yaw
    describe: Callable[[np.ndarray], np.ndarray] | None = None  # of a submap's points (n, 3): what samples must hold

    @abstractmethod
    def start(self, training: Samples) -> None:
        """Set the untrained model to a sensible answer for submaps like these."""

    @abstractmethod
    def inputs(
        self, samples: Samples, which: np.ndarray, points: int | None, rng: np.random.Generator
    ) -> tuple[np.ndarray, ...]:
        """Return what `forward` takes, float32, for the chosen submaps.

        Each is seen by as many random points as `points` says; None: by all of them, and `which` has one index.
        """

    @abstractmethod
    def example(self) -> dict[str, Example]:
        """Return an input of two submaps for each argument of `forward`, in their order, by its name."""


class Covariance(nn.Module):
    """A model that answers with Q itself: what is exported for use elsewhere."""

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
        raise ModelError("a model in training mode judges a cloud by its batch; call model.eval() before predict")
    with torch.inference_mode():
        numbers = model(*to_tensors(model, inputs)).double()
        return np.asarray(cholesky.covariance(numbers, model.settings.dimensions).cpu())


def to_tensors(model: Model, inputs: tuple[np.ndarray, ...]) -> tuple[Tensor, ...]:
    """Return inputs as tensors where the model is."""
    where = next(model.parameters()).device
    return tuple(torch.from_numpy(np.ascontiguousarray(each)).to(where) for each in inputs)
