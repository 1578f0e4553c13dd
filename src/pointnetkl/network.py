"""PointNetKL: a point cloud in, the covariance of its registration out; and the divergence that trains it.

PointNet (Qi et al. 2017) without its heads describes the cloud by zeta; an MLP turns zeta into [l, d], the numbers
of a Cholesky composition, Sigma = L(l) diag(exp d) L(l)^T (section IV of the paper).
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor, nn

from pointnetkl import settings
from pointnetkl.errors import PointNetKLError


class NetworkError(PointNetKLError):
    """The network is used in a way that would give a wrong answer."""


@dataclass(frozen=True)
class Settings:
    """What the network is made of (section `network`).

    Raises:
        ValueError: a number cannot be one of a network's.
    """

    scale_input: bool  # join ln(rho / 100 m) to zeta: without it no network can know metres
    hidden_layers: int  # of psi, the MLP after PointNet
    hidden_width: int
    dropout: float  # share of psi's hidden outputs set to zero in training
    dimensions: int = 2  # M: 2 for x, y; 3 with yaw

    def __post_init__(self) -> None:
        """Refuse what makes no network."""
        settings.require_positive(self, "hidden_layers", "hidden_width")
        if not 0 <= self.dropout < 1:
            raise ValueError(f"dropout is {self.dropout:g}, must be at least 0 and below 1")
        if self.dimensions not in (2, 3):
            raise ValueError(f"dimensions is {self.dimensions}, must be 2 (x, y) or 3 (x, y, yaw)")


class PointMLP(nn.Sequential):
    """Linear, batch norm, ReLU per width, shared by all points.

    Points of all clouds are rows of one (n, channels) matrix: a matrix product is a third faster on a CPU than the
    same 1x1 convolution, and every row that enters a batch norm is a point that was measured.
    """

    def __init__(self, widths: Sequence[int]) -> None:
        """Make the layers between the given numbers of channels."""
        layers = ((nn.Linear(a, b), nn.BatchNorm1d(b), nn.ReLU(inplace=True)) for a, b in itertools.pairwise(widths))
        super().__init__(*itertools.chain.from_iterable(layers))


class TransformNet(nn.Module):
    """T-Net: a (channels, channels) matrix for each cloud, the identity before training."""

    def __init__(self, channels: int) -> None:
        """Make the T-Net; Qi et al. 2017, appendix C."""
        super().__init__()
        self.channels = channels
        self.points = PointMLP((channels, 64, 128, 1024))
        self.cloud = PointMLP((1024, 512, 256))
        self.matrix = nn.Linear(256, channels * channels)
        nn.init.zeros_(self.matrix.weight)
        nn.init.zeros_(self.matrix.bias)

    def forward(self, features: Tensor) -> Tensor:
        """Return features (B, n, channels), each cloud's multiplied by its own matrix."""
        change = self.matrix(self.cloud(_pooled(self.points, features)))
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
        self.globally = PointMLP((64, 64, 128, self.features))

    def forward(self, points: Tensor) -> Tensor:
        """Return zeta (B, 1024) of points (B, n, 3)."""
        features = _shared(self.local, self.input_transform(points))
        return _pooled(self.globally, self.feature_transform(features))


class PointNetKL(nn.Module):
    """pi: [l, d] of a cloud in the canonical form (zero mean, unit sphere, voxelised) and its radius rho."""

    def __init__(self, chosen: Settings) -> None:
        """Make phi and psi, their weights drawn from torch's generator."""
        super().__init__()
        self.settings = chosen
        self.phi = PointNet()
        inputs = PointNet.features + int(chosen.scale_input)
        widths = [inputs] + [chosen.hidden_width] * chosen.hidden_layers
        hidden = (_hidden(a, b, chosen.dropout) for a, b in itertools.pairwise(widths))
        numbers = chosen.dimensions * (chosen.dimensions + 1) // 2
        self.psi = nn.Sequential(*itertools.chain.from_iterable(hidden))
        self.last = nn.Linear(widths[-1], numbers)

    def forward(self, points: Tensor, radius: Tensor) -> Tensor:
        """Return [l, d], (B, M (M - 1) / 2 + M), of points (B, n, 3) and radii (B,) in metres."""
        zeta = self.phi(points)
        if self.settings.scale_input:
            # the logarithm, because a covariance grows with a power of length; 100 m, the order of a swath, makes
            # it as small as the features that it joins
            zeta = torch.cat([zeta, torch.log(radius[:, None] / 100.0)], dim=1)
        return self.last(self.psi(zeta))


class Covariance(nn.Module):
    """A PointNetKL that answers with Q itself: what is exported for use elsewhere."""

    def __init__(self, model: PointNetKL) -> None:
        """Wrap a model."""
        super().__init__()
        self.model = model

    def forward(self, points: Tensor, radius: Tensor) -> Tensor:
        """Return Q (B, M, M) in m^2 of points (B, n, 3) and radii (B,) in metres."""
        return covariance(self.model(points, radius), self.model.settings.dimensions)


def covariance(numbers: Tensor, dimensions: int = 2) -> Tensor:
    """Return Sigma = L(l) diag(exp d) L(l)^T, (B, M, M), of [l, d] (B, M (M + 1) / 2)."""
    # a factor times its transpose: the product is symmetric whatever the rounding
    factor = _lower(numbers, dimensions) * torch.exp(0.5 * numbers[:, None, -dimensions:])
    return factor @ factor.transpose(1, 2)


def predict(model: PointNetKL, points: np.ndarray, radius: float) -> np.ndarray:
    """Return Q (M, M) in m^2, float64, of one whole canonical cloud (n, 3) and its radius in metres.

    The model must be in evaluation mode: the answer then depends on this cloud alone. Safe to call from threads.

    Raises:
        NetworkError: the model is in training mode.
    """
    if model.training:
        raise NetworkError("a model in training mode judges a cloud by its batch; call model.eval() before predict")
    where = next(model.parameters())
    with torch.inference_mode():
        cloud = torch.from_numpy(np.ascontiguousarray(points)).to(where)[None]
        numbers = model(cloud, torch.tensor([radius]).to(where))
        return np.asarray(covariance(numbers.double(), model.settings.dimensions)[0].cpu())


def kl_divergence(label_factor: Tensor, numbers: Tensor) -> Tensor:
    """Return KL(N(0, label) || N(0, Sigma)) in nats, (B,), Eq. 9 of the paper with zero means.

    The label is given by its lower Cholesky factor C (B, M, M) and the prediction by [l, d]: the trace is
    |diag(exp(-d / 2)) L^-1 C|^2 by forward substitution, and both determinants are sums of logarithms, so nothing
    is inverted and nothing underflows.
    """
    m = label_factor.shape[-1]
    d = numbers[:, -m:]
    whitened = torch.linalg.solve_triangular(_lower(numbers, m), label_factor, upper=False, unitriangular=True)
    trace = (whitened.square() * torch.exp(-d)[:, :, None]).sum(dim=(1, 2))
    label_log_determinant = 2.0 * label_factor.diagonal(dim1=1, dim2=2).log().sum(1)
    return 0.5 * (trace - m + d.sum(1) - label_log_determinant)


def _lower(numbers: Tensor, m: int) -> Tensor:
    """Return L(l), unit lower triangular, its rows filled in order."""
    places = [(row, column) for row in range(m) for column in range(row)]
    units = torch.zeros(len(places), m, m)
    for unit, place in zip(units, places, strict=True):
        unit[place] = 1.0
    identity, units = torch.eye(m).to(numbers), units.to(numbers)
    return identity + (numbers[:, :-m, None, None] * units).sum(dim=1)


def _shared(layers: nn.Module, features: Tensor) -> Tensor:
    """Return layers applied to every point of features (B, n, channels)."""
    clouds, points, channels = features.shape
    return layers(features.reshape(-1, channels)).reshape(clouds, points, -1)


def _pooled(layers: nn.Module, features: Tensor) -> Tensor:
    """Return the largest value over a cloud's points of each channel of the layers."""
    shared = _shared(layers, features)
    # the same number twice: max is faster where a gradient follows, amax four times where none does
    return shared.max(dim=1).values if shared.requires_grad else shared.amax(dim=1)


def _hidden(inputs: int, outputs: int, dropout: float) -> tuple[nn.Module, ...]:
    """Return one layer of psi, in the paper's order."""
    return nn.Linear(inputs, outputs), nn.BatchNorm1d(outputs), nn.Dropout(dropout), nn.ReLU(inplace=True)
