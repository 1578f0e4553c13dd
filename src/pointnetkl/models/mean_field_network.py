"""`network`, our best model: the mean field's covariance, corrected along its axes by a few small networks.

The description of a submap (package mean_field) gives a covariance by physics alone. Along each of its axes the small
networks learn a correction of the log variance. They see every axis by numbers that do not change when the submap is
turned, so what they learn of one heading holds for all. Before training they correct nothing.
"""

import math
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from pointnetkl.models import mean_field
from pointnetkl.models.mean_field import Conditions, Description
from pointnetkl.models.model import Example, Model
from pointnetkl.models.samples import Samples
from pointnetkl.workflow import parameters
from pointnetkl.workflow.errors import PointNetKLError

AXIS, WHOLE = 5, 3  # numbers that describe an axis, and the submap
_FAR = 3.0  # standard deviations of the training submaps: a number farther out is moved to there
_SETTLED_M = 2.0  # an end farther than this from the truth along an axis is lost


class MeanFieldNetworkError(PointNetKLError):
    """A model lacks the descriptions or the conditions that it needs."""


@dataclass(frozen=True)
class Settings:
    """The size of the networks, and the registrations that the model describes.

    Raises:
        ValueError: a number cannot be one of a network's.
    """

    members: int  # networks, whose corrections are averaged
    hidden_width: int
    most: float  # correction of a log variance, to either side
    jitter: float  # noise on inputs in training, in standard deviations
    dimensions: int = 2  # M: 2 for x, y; 3 with yaw
    conditions: Conditions | None = None  # of the labels that it learns; not in a file of parameters

    def __post_init__(self) -> None:
        """Refuse numbers that make no network."""
        parameters.require_positive(self, "members", "hidden_width", "most")
        if self.jitter < 0:
            raise ValueError(f"jitter is {self.jitter:g}, must be 0 or above")
        if self.dimensions not in (2, 3):
            raise ValueError(f"dimensions is {self.dimensions}, must be 2 or 3")
        if isinstance(self.conditions, dict):  # as a model's file has them
            object.__setattr__(self, "conditions", Conditions(**self.conditions))


class MeanFieldNetwork(Model):
    """[l, d] of descriptions, as `vector` gives them."""

    centre: Tensor  # (inputs,) of the training submaps, as the next
    spread: Tensor

    def __init__(self, settings: Settings) -> None:
        """Make the members, their weights drawn from torch's generator, their corrections zero."""
        super().__init__()
        self.settings = settings
        inputs, width = 2 * AXIS + WHOLE + 1, settings.hidden_width
        widths = ((inputs, width), (width, width), (width, 1))
        self.weights = nn.ParameterList(torch.randn(settings.members, a, b) / math.sqrt(a) for a, b in widths)
        self.biases = nn.ParameterList(torch.zeros(settings.members, 1, b) for _, b in widths)
        nn.init.zeros_(self.weights[-1])
        self.register_buffer("centre", torch.zeros(inputs))
        self.register_buffer("spread", torch.ones(inputs))

    def start(self, training: Samples) -> None:
        """Take centre and spread of the inputs from the training submaps."""
        inputs = self._axes(torch.from_numpy(_described(training))).flatten(0, 1)
        self.centre.copy_(inputs.mean(dim=0))
        # a number that is the same in every training submap must not become infinite in another
        self.spread.copy_(inputs.std(dim=0) + 0.01)

    def inputs(
        self, samples: Samples, indices: np.ndarray, points: int | None, rng: np.random.Generator
    ) -> tuple[np.ndarray, ...]:
        """Return the descriptions (B, D), which are of all points whatever `points` says."""
        return (_described(samples)[indices],)

    def example(self) -> dict[str, Example]:
        """Return two descriptions of flat ground."""
        m = self.settings.dimensions
        value = torch.zeros(2, m + 2 + m * AXIS + WHOLE)
        value[:, m] = 1.0
        return {"description": Example(value, {0: "clouds"})}

    def describe(self, points: np.ndarray) -> np.ndarray:
        """Return what `forward` takes (D,), float32, of a submap's points (n, 3), metres, in its frame.

        Raises:
            MeanFieldNetworkError: the settings have no conditions.
            MeanFieldError: the points have no ground.
        """
        conditions = self.settings.conditions
        if conditions is None:
            raise MeanFieldNetworkError("the model does not say which registrations it describes; train it again")
        return vector(mean_field.describe(points, conditions), conditions, self.settings.dimensions)

    def forward(self, description: Tensor) -> Tensor:
        """Return [l, d], (B, M (M + 1) / 2), of descriptions (B, D)."""
        m = self.settings.dimensions
        typical = ((self._axes(description) - self.centre) / self.spread).clamp(-_FAR, _FAR)
        if self.training:
            typical = typical + self.settings.jitter * torch.randn_like(typical)
        most = self.settings.most
        correction = most * torch.tanh(self._members(typical.flatten(0, 1)).reshape(-1, m) / most)
        return _numbers(description[:, :m] + correction, description[:, m], description[:, m + 1])

    def _members(self, inputs: Tensor) -> Tensor:
        """Return the mean answer (n, 1) of the members to inputs (n, inputs)."""
        hidden = inputs[None]
        for weight, bias in zip(self.weights[:-1], self.biases[:-1], strict=True):
            hidden = functional.silu(hidden @ weight + bias)
        return (hidden @ self.weights[-1] + self.biases[-1]).mean(dim=0)

    def _axes(self, description: Tensor) -> Tensor:
        """Return what the members see of each axis, (B, M, inputs): it, the mean of the others, the submap."""
        m = self.settings.dimensions
        own = description[:, m + 2 : m + 2 + m * AXIS].reshape(-1, m, AXIS)
        others = (own.sum(dim=1, keepdim=True) - own) / (m - 1)
        whole = description[:, None, -WHOLE:].expand(-1, m, WHOLE)
        yaw = torch.zeros_like(own[:, :, :1])
        yaw[:, 2:] = 1.0
        return torch.cat([own, others, whole, yaw], dim=2)


def vector(described: Description, conditions: Conditions, dimensions: int) -> np.ndarray:
    """Return the numbers of a description that the network sees, (D,), float32.

    The logarithms of the variances (m^2, rad^2) along M axes, those in x, y ascending; cosine and sine of the first
    one; AXIS numbers of each axis, WHOLE of the submap. Lengths along yaw are those of an arc at the points' rms
    distance from their mean.
    """
    variances, axes = np.linalg.eigh(described.covariance)
    per_axis = _along(described, axes)
    if dimensions == 3:
        arm = float(np.trace(described.extent))  # m^2
        yaw = described.yaw_variance(conditions)
        variances = np.append(variances, yaw)
        per_axis = np.column_stack([per_axis, [yaw * arm, *described.turning / arm, arm, 0.0]])
    whole = [
        np.log(described.spacing_m / conditions.prior_sigma_m),
        0.5 * np.log(described.points),
        described.iterations.mean() / 20,
    ]
    own = _compressed(per_axis, described.spacing_m)
    return np.concatenate([np.log(variances), axes[:, 0], own.ravel(), whole]).astype(np.float32)


def _along(described: Description, axes: np.ndarray) -> np.ndarray:
    """Return the numbers of axes in x, y (the columns of `axes`), (AXIS, 2).

    Variance, stiffness, noise and extent along each, and the share of ends that have not settled near the truth.
    """
    matrices = (described.covariance, described.stiffness, described.noise, described.extent)
    lost = np.mean(np.abs(described.ends @ axes) > _SETTLED_M, axis=0)
    return np.stack([*(np.einsum("ji,jk,ki->i", axes, matrix, axes) for matrix in matrices), lost])


def _compressed(per_axis: np.ndarray, spacing: float) -> np.ndarray:
    """Return what `_along` gives in numbers of similar size, (M, AXIS): logarithms of roots, except the share."""
    variance, stiffness, noise, extent, lost = per_axis
    roots = [variance + 1e-3, stiffness + 1e-4, noise / (stiffness + 1e-9) + 0.1, extent / spacing**2]
    return np.stack([*(0.5 * np.log(root) for root in roots), lost], axis=1)


def _numbers(log_variances: Tensor, cosine: Tensor, sine: Tensor) -> Tensor:
    """Return [l, d] of the covariance with these variances along an axis at the angle, the axis across it, and yaw."""
    first, second = log_variances[:, 0].exp(), log_variances[:, 1].exp()
    xx = first * cosine**2 + second * sine**2
    lower = (first - second) * sine * cosine / xx
    # from the determinant, which no rotation changes: yy - xy^2 / xx would lose digits
    d = torch.stack([xx.log(), log_variances[:, 0] + log_variances[:, 1] - xx.log()], dim=1)
    if log_variances.shape[1] == 2:
        return torch.cat([lower[:, None], d], dim=1)
    zero = torch.zeros_like(lower)
    return torch.cat([torch.stack([lower, zero, zero], dim=1), d, log_variances[:, 2:]], dim=1)


def _described(samples: Samples) -> np.ndarray:
    if samples.described is None:
        raise MeanFieldNetworkError("the training submaps have no descriptions; read them with the model's `describe`")
    return samples.described
