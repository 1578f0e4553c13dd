"""PointNetKL: a point cloud in, the covariance of its registration out.

PointNet (Qi et al. 2017) without its heads describes the cloud by zeta; an MLP turns zeta into [l, d], the numbers
of a Cholesky composition (section IV of the paper).
"""

import itertools
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor, nn

from pointnetkl.models.model import Example, Model
from pointnetkl.models.point_mlp import PointMLP, PooledMLP, to_rows
from pointnetkl.models.samples import Samples
from pointnetkl.workflow import parameters


@dataclass(frozen=True)
class Settings:
    """The size and inputs of the network (`network` of a model of this kind).

    Raises:
        ValueError: a number cannot be one of a network's.
    """

    scale_input: bool  # join ln(rho / 100 m) to zeta: without it no network can know metres
    hidden_layers: int  # of psi, the MLP after PointNet
    hidden_width: int
    dropout: float  # share of psi's hidden outputs set to zero in training
    dimensions: int = 2  # M: 2 for x, y; 3 with yaw

    def __post_init__(self) -> None:
        """Refuse numbers that make no network."""
        parameters.require_positive(self, "hidden_layers", "hidden_width")
        if not 0 <= self.dropout < 1:
            raise ValueError(f"dropout is {self.dropout:g}, must be at least 0 and below 1")
        if self.dimensions not in (2, 3):
            raise ValueError(f"dimensions is {self.dimensions}, must be 2 (x, y) or 3 (x, y, yaw)")


class TransformNet(nn.Module):
    """T-Net: a (channels, channels) matrix for each cloud, the identity before training."""

    def __init__(self, channels: int) -> None:
        """Make the T-Net; Qi et al. 2017, appendix C."""
        super().__init__()
        self.channels = channels
        self.points = PooledMLP((channels, 64, 128, 1024))
        self.cloud = PointMLP((1024, 512, 256))
        self.matrix = nn.Linear(256, channels * channels)
        nn.init.zeros_(self.matrix.weight)
        nn.init.zeros_(self.matrix.bias)

    def forward(self, features: Tensor) -> Tensor:
        """Return features (B, n, channels), each cloud's multiplied by its own matrix."""
        change = self.matrix(self.cloud(self.points(features)))
        # added here and not held in the bias, so that weight decay pulls towards the identity, not to zero
        identity = torch.eye(self.channels).to(features)
        return features @ (change.reshape(-1, self.channels, self.channels) + identity)


class PointNet(nn.Module):
    """phi: a cloud's global feature zeta, the same for any order of its points (Qi et al. 2017, no heads)."""

    features = 1024  # Z, the length of zeta

    def __init__(self) -> None:
        """Make the input transform, the feature transform and the shared MLPs."""
        super().__init__()
        self.input_transform = TransformNet(3)
        self.local = PointMLP((3, 64, 64))
        self.feature_transform = TransformNet(64)
        self.globally = PooledMLP((64, 64, 128, self.features))

    def forward(self, points: Tensor) -> Tensor:
        """Return zeta (B, 1024) of points (B, n, 3)."""
        features = to_rows(self.local, self.input_transform(points))
        return self.globally(self.feature_transform(features))


class PointNetKL(Model):
    """pi: [l, d] of a cloud in the canonical form (zero mean, unit sphere, voxelised) and its radius rho."""

    def __init__(self, settings: Settings) -> None:
        """Make phi and psi, their weights drawn from torch's generator."""
        super().__init__()
        self.settings = settings
        self.phi = PointNet()
        inputs = PointNet.features + int(settings.scale_input)
        widths = [inputs] + [settings.hidden_width] * settings.hidden_layers
        hidden = (_hidden(a, b, settings.dropout) for a, b in itertools.pairwise(widths))
        numbers = settings.dimensions * (settings.dimensions + 1) // 2
        self.psi = nn.Sequential(*itertools.chain.from_iterable(hidden))
        self.last = nn.Linear(widths[-1], numbers)

    def start(self, training: Samples) -> None:
        """Answer with the mean label, which of all constants has the least mean KL.

        From the random weights' 1 m^2 a tenth of the demo's steps would only get here. The paper does not say how
        it starts.
        """
        factor = np.linalg.cholesky(training.label.mean(axis=0))
        lower = factor / np.diag(factor)
        numbers = [*lower[np.tril_indices(len(factor), -1)], *2 * np.log(np.diag(factor))]
        nn.init.zeros_(self.last.weight)
        with torch.no_grad():
            self.last.bias.copy_(torch.tensor(numbers))

    def forward(self, points: Tensor, radius: Tensor) -> Tensor:
        """Return [l, d], (B, M (M - 1) / 2 + M), of points (B, n, 3) and radii (B,) in metres."""
        zeta = self.phi(points)
        if self.settings.scale_input:
            # the logarithm, because a covariance grows with a power of length; 100 m, the order of a swath, makes
            # it as small as the features that it joins
            zeta = torch.cat([zeta, torch.log(radius[:, None] / 100.0)], dim=1)
        return self.last(self.psi(zeta))

    def inputs(
        self, samples: Samples, indices: np.ndarray, points: int | None, rng: np.random.Generator
    ) -> tuple[np.ndarray, ...]:
        """Return points (b, n, 3) of canonical clouds and their radii (b,), float32."""
        return samples.draw(indices, points, rng)

    def example(self) -> dict[str, Example]:
        """Return two clouds and their radii; there may be more, of more points."""
        points = Example(torch.zeros(2, 8, 3), {0: "clouds", 1: "points"})
        return {"points": points, "radius": Example(torch.ones(2), {0: "clouds"})}


def _hidden(inputs: int, outputs: int, dropout: float) -> tuple[nn.Module, ...]:
    """Return one layer of psi, in the paper's order."""
    return nn.Linear(inputs, outputs), nn.BatchNorm1d(outputs), nn.Dropout(dropout), nn.ReLU(inplace=True)
