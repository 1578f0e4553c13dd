"""[l, d], the numbers of a Cholesky composition: Sigma = L(l) diag(exp d) L(l)^T (section IV of the paper)."""

import torch
from torch import Tensor


def covariance(numbers: Tensor, dimensions: int = 2) -> Tensor:
    """Return Sigma = L(l) diag(exp d) L(l)^T, (B, M, M), of [l, d] (B, M (M + 1) / 2)."""
    # a factor times its transpose: the product is symmetric whatever the rounding
    root = factor(numbers, dimensions)
    return root @ root.transpose(1, 2)  # ONNX has no mT


def factor(numbers: Tensor, m: int) -> Tensor:
    """Return L(l) diag(exp(d / 2)), the lower triangular root of Sigma, (B, M, M)."""
    return _lower(numbers, m) * torch.exp(0.5 * numbers[:, None, -m:])


def kl_divergence(label: Tensor, numbers: Tensor, floor: Tensor) -> Tensor:
    """Return KL(N(0, label + F) || N(0, Sigma + F)) in nats, (B,): Eq. 9 of the paper with zero means.

    `label` is (B, M, M), `numbers` are [l, d], `floor` (M,) the diagonal of F. Sigma + F is never formed: it is A^T A
    with Sigma's root and F's above each other in A, and A = Q R gives its Cholesky factor R^T, which therefore keeps
    all the digits of an eigenvalue far below the others. Nothing is inverted.
    """
    m = len(floor)
    label_root = torch.linalg.cholesky(label + torch.diag(floor))
    floor_root = torch.diag(floor.sqrt()).expand(len(numbers), m, m)
    upper = torch.linalg.qr(torch.cat([factor(numbers, m).mT, floor_root], dim=1)).R
    whitened = torch.linalg.solve_triangular(upper.mT, label_root, upper=False)
    return 0.5 * (whitened.square().sum(dim=(1, 2)) - m) + _log_diagonal(upper) - _log_diagonal(label_root)


def _log_diagonal(triangular: Tensor) -> Tensor:
    return triangular.diagonal(dim1=1, dim2=2).abs().log().sum(1)


def _lower(numbers: Tensor, m: int) -> Tensor:
    """Return L(l), unit lower triangular, its rows filled in order."""
    places = [(row, column) for row in range(m) for column in range(row)]
    # spelled out, because ONNX loses what is written into a part of a tensor
    units = [[[float((i, j) == place) for j in range(m)] for i in range(m)] for place in places]
    below = numbers[:, :-m, None, None] * torch.tensor(units).to(numbers)
    return torch.eye(m).to(numbers) + below.sum(dim=1)
