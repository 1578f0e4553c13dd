"""The loss: the KL divergence from the labels to the model's answers."""

import numpy as np
import torch
from torch import Tensor

from pointnetkl.models import cholesky
from pointnetkl.models.model import Model, to_tensors
from pointnetkl.models.samples import Samples
from pointnetkl.registration.covariance import gaussian


def divergences(
    model: Model, samples: Samples, indices: np.ndarray, points: int | None, floor_m2: float, rng: np.random.Generator
) -> Tensor:
    """Return KL(label + floor || answer + floor) of some submaps in nats, (b,) float64.

    The model sees `points` random points of each submap (None: all of them).

    The floor is added to both, as where methods are judged; the answer itself is without it.
    """
    numbers = model(*to_tensors(model, model.inputs(samples, indices, points, rng))).double()
    label = samples.label[indices]
    floor = np.diag(gaussian.with_floor(np.zeros(label.shape[1:]), floor_m2))
    return cholesky.kl_divergence(torch.from_numpy(label).to(numbers), numbers, torch.tensor(floor).to(numbers))
