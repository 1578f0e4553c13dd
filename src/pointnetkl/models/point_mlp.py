"""MLPs that all points of a cloud share, and the largest of their outputs over a cloud: what a PointNet is made of.

On a CPU a training step is seven times as fast as torch's layers one after the other, and gives what these give, to
rounding: norm and ReLU go together, and a pooled layer is differentiated at the points that are largest alone.
"""

import contextlib
import itertools
from collections.abc import Iterator, Sequence
from typing import Any, cast

import torch
from torch import Tensor, nn
from torch.autograd.function import once_differentiable
from torch.nn import functional

from pointnetkl.models import point_kernels
from pointnetkl.models.model import ModelError

_CACHED = 2048  # points whose 1024 outputs stay in the cache until their largest are found


@contextlib.contextmanager
def matrix_products(precision: str) -> Iterator[None]:
    """Multiply float32 matrices in `float32`; with `bfloat16` torch may round their factors, where that is faster.

    On an AMD EPYC with AVX-512 it rounds nothing, and takes other kernels that are twice as fast.
    """
    before = torch.get_float32_matmul_precision()
    torch.set_float32_matmul_precision("medium" if precision == "bfloat16" else "highest")
    try:
        yield
    finally:
        torch.set_float32_matmul_precision(before)


class PointMLP(nn.Sequential):
    """Linear, batch norm, ReLU per width, shared by all points.

    Points of all clouds are rows of one (n, channels) matrix: a matrix product is a third faster on a CPU than the
    same 1x1 convolution, and every row that enters a batch norm is a point that was measured.
    """

    def __init__(self, widths: Sequence[int]) -> None:
        """Make the layers between the given numbers of channels."""
        layers = ((nn.Linear(a, b), nn.BatchNorm1d(b), nn.ReLU(inplace=True)) for a, b in itertools.pairwise(widths))
        super().__init__(*itertools.chain.from_iterable(layers))

    def layers(self) -> list[tuple[nn.Linear, nn.BatchNorm1d]]:
        """Return the linear layers, each with its norm."""
        return [(cast(nn.Linear, self[i]), cast(nn.BatchNorm1d, self[i + 1])) for i in range(0, len(self), 3)]

    def forward(self, rows: Tensor) -> Tensor:
        """Return the outputs (n, widths[-1]) of rows (n, channels)."""
        return _through(self.layers(), rows)


class PooledMLP(PointMLP):
    """A PointMLP and the largest value over a cloud's points of each of its channels, (B, n, channels) to (B, widths).

    Batch norm and ReLU follow each channel up or down, so the largest value is that of the point whose linear
    output is largest, or smallest where the norm's weight is negative: the wide last layer is searched for that
    point, and nothing else of it is computed or kept. Its mean and variance follow from those of its inputs.

    Where the search rounds (`search_in`), it ends at a point whose value, which is computed in float32, is the
    largest but for some 0.4 % of the sum of |w f| over the inputs f.
    """

    search = "float32"  # precision of the search, as of `matrix_products`

    def forward(self, features: Tensor) -> Tensor:
        """Return the largest values (B, widths[-1]) of features (B, n, channels)."""
        *before, (linear, norm) = self.layers()
        shared = to_rows(lambda rows: _through(before, rows), features)
        upwards = torch.where(norm.weight < 0, -1.0, 1.0).detach()
        if not norm.training:
            top = (upwards[:, None] * linear.weight @ shared.transpose(1, 2)).amax(dim=2) * upwards
            mean, variance = _remembered(norm)[0] - linear.bias, _remembered(norm)[1]
        else:
            if _has_kernels(shared):
                top, mean, variance = _Pool.apply(shared, linear.weight, upwards, self.search)  # type: ignore[no-untyped-call]
            else:
                top, mean, variance = _pool(shared, linear.weight, upwards)
            _remember(norm, mean.detach() + linear.bias.detach(), variance.detach(), shared.shape[0] * shared.shape[1])
        # the bias adds to the largest value and to the mean alike, and so to nothing
        return functional.relu((top - mean) * torch.rsqrt(variance + norm.eps) * norm.weight + norm.bias)


def search_in(model: nn.Module, precision: str) -> None:
    """Let all PooledMLPs of a model search in this precision, as of `matrix_products`, when they train on a CPU."""
    for module in model.modules():
        if isinstance(module, PooledMLP):
            module.search = precision


def to_rows(layers: Any, features: Tensor) -> Tensor:
    """Return layers applied to every point of features (B, n, channels)."""
    clouds, points, channels = features.shape
    return cast(Tensor, layers(features.reshape(-1, channels)).reshape(clouds, points, -1))


def _through(layers: Sequence[tuple[nn.Linear, nn.BatchNorm1d]], rows: Tensor) -> Tensor:
    for linear, norm in layers:
        rows = linear(rows)
        if norm.training and _has_kernels(rows):
            rows, mean, variance = _NormReLU.apply(rows, norm.weight, norm.bias, norm.eps)  # type: ignore[no-untyped-call]
            _remember(norm, mean, variance, len(rows))
        else:
            rows = functional.relu(norm(rows))
    return rows


def _has_kernels(features: Tensor) -> bool:
    return features.device.type == "cpu" and features.dtype == torch.float32 and not torch.is_autocast_enabled("cpu")


class _NormReLU(torch.autograd.Function):
    """Batch norm in training (Ioffe and Szegedy 2015) and ReLU of rows (n, channels), with their mean and variance."""

    @staticmethod
    def forward(ctx: Any, rows: Tensor, weight: Tensor, bias: Tensor, eps: float) -> tuple[Tensor, Tensor, Tensor]:
        rows = rows.contiguous()
        totals = torch.empty(point_kernels.PARTS, 2, rows.shape[1])
        point_kernels.sums(rows.numpy(), totals.numpy())
        # about the first row: about zero, a channel far from it would lose its variance to rounding
        first, second = totals.double().sum(dim=0) / len(rows)
        mean, variance = (rows[0] + first).float(), (second - first**2).clamp(min=0).float()
        inverse = torch.rsqrt(variance + eps)
        scale = weight * inverse
        shift = bias - mean * scale
        outputs = torch.empty_like(rows)
        point_kernels.scale_relu(rows.numpy(), scale.numpy(), shift.numpy(), outputs.numpy())
        ctx.save_for_backward(rows, scale, shift, mean, inverse)
        ctx.mark_non_differentiable(mean, variance)
        return outputs, mean, variance

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, gradient: Tensor, *_: Tensor) -> tuple[Tensor, Tensor, Tensor, None]:
        rows, scale, shift, mean, inverse = ctx.saved_tensors
        gradient = gradient.contiguous()
        arrays = [tensor.numpy() for tensor in (gradient, rows, scale, shift)]
        totals = torch.empty(point_kernels.PARTS, 2, rows.shape[1])
        point_kernels.gradient_sums(*arrays, mean.numpy(), totals.numpy())
        to_bias, centred = totals.double().sum(dim=0).float()
        slope = scale * centred * inverse**2 / len(rows)
        constant = scale * to_bias / len(rows) - mean * slope
        to_input = torch.empty_like(rows)
        point_kernels.gradient_of_rows(*arrays, constant.numpy(), slope.numpy(), to_input.numpy())
        return to_input, centred * inverse, to_bias, None


class _Pool(torch.autograd.Function):
    """`_pool` by the kernels: the gradient goes to the points that are largest, and by the moments to all."""

    @staticmethod
    def forward(
        ctx: Any, features: Tensor, weight: Tensor, upwards: Tensor, search: str
    ) -> tuple[Tensor, Tensor, Tensor]:
        features = features.contiguous()
        with matrix_products(search):
            points = _search(features, (upwards[:, None] * weight).T.contiguous())
        top = torch.empty(points.shape)
        point_kernels.at_points(features.numpy(), weight.numpy(), points.numpy(), top.numpy())
        rows = features.reshape(-1, features.shape[2])
        centre = rows.mean(dim=0)
        centred = rows - centre
        scatter = centred.T @ centred / len(rows)
        ctx.save_for_backward(features, weight, points, centre, scatter)
        return top, weight @ centre, ((weight @ scatter) * weight).sum(dim=1)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, top: Tensor, mean: Tensor, variance: Tensor) -> tuple[Tensor, Tensor, None, None]:
        features, weight, points, centre, scatter = ctx.saved_tensors
        rows = features.reshape(-1, features.shape[2])
        # variance_o = w_o . scatter w_o, and the mean of w_o . f is w_o . centre: their gradients by each row f
        by_row = 2 / len(rows) * (weight.T @ (variance[:, None] * weight))
        constant = weight.T @ mean / len(rows) - by_row @ centre
        to_features = torch.addmm(constant, rows, by_row).reshape(features.shape)
        to_weight = mean[:, None] * centre + 2 * variance[:, None] * (weight @ scatter)
        gradient = top.contiguous().numpy()
        point_kernels.add_to_features(gradient, weight.numpy(), points.numpy(), to_features.numpy())
        point_kernels.add_to_weight(gradient, features.numpy(), points.numpy(), to_weight.numpy())
        return to_features, to_weight, None, None


def _search(features: Tensor, upwards: Tensor) -> Tensor:
    """Return which point of features (B, n, c) has the largest product with each column, (B, channels) int32."""
    clouds, count, channels = features.shape
    points = torch.empty(clouds, upwards.shape[1], dtype=torch.int32)
    first = 0
    for part in torch.split(features, max(1, _CACHED // count)):
        outputs = part.reshape(-1, channels) @ upwards
        point_kernels.point_of_largest(outputs.reshape(len(part), count, -1).numpy(), first, points.numpy())
        first += len(part)
    return points


def _pool(features: Tensor, weight: Tensor, upwards: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Return of features (B, n, c), each times `weight` (channels, c): the largest, the mean and the variance.

    The largest (B, channels) is over a cloud's points, of the products times `upwards`, 1 or -1 a channel, and is given
    without it. Mean and variance (channels,) are over all points.
    """
    searched = (upwards[:, None] * weight).detach()
    parts = torch.split(features.detach(), max(1, _CACHED // features.shape[1]))
    points = torch.cat([(searched @ part.mT).max(dim=2).indices for part in parts])
    # rows of all clouds' points: an embedding's gradient is gathered in a fixed order, and fast
    indices = points + features.shape[1] * torch.arange(len(features), device=features.device)[:, None]
    largest = functional.embedding(indices, features.reshape(-1, features.shape[2]))
    with torch.autocast(features.device.type, enabled=False):
        rows = features.to(weight).reshape(-1, features.shape[2])
        centre = rows.mean(dim=0)
        centred = rows - centre
        scatter = centred.T @ centred / len(rows)
        return (largest * weight).sum(dim=2), weight @ centre, ((weight @ scatter) * weight).sum(dim=1)


@torch.no_grad()
def _remember(norm: nn.BatchNorm1d, mean: Tensor, variance: Tensor, count: int) -> None:
    """Update a batch norm's running statistics as it does itself; momentum None: their average."""
    if count < 2:
        raise ModelError(f"a batch norm in training has {count} row to take a variance of; give it two points at least")
    batches = norm.get_buffer("num_batches_tracked").add_(1)
    share = 1 / float(batches) if norm.momentum is None else norm.momentum
    for running, now in zip(_remembered(norm), (mean, variance * count / (count - 1)), strict=True):
        running.lerp_(now, share)


def _remembered(norm: nn.BatchNorm1d) -> tuple[Tensor, Tensor]:
    return norm.get_buffer("running_mean"), norm.get_buffer("running_var")
