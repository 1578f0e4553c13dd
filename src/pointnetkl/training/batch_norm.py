"""Batch norms for evaluation: the means and variances of large batches under the present weights."""

import numpy as np
import torch
from torch import nn

from pointnetkl.models.model import Model, to_tensors
from pointnetkl.models.samples import Samples


def take_statistics(
    model: Model, samples: Samples, parts: list[np.ndarray], points: int | None, rng: np.random.Generator
) -> None:
    """Replace batch-norm statistics by the average over batches of submaps, and leave the model in evaluation mode.

    The running average of training is of weights that have changed since, and of batches without the rare steep
    submap. Deep layers multiply both errors, and exp(d) explodes. Dropout is off, as it is in evaluation.
    """
    norms = [module for module in model.modules() if isinstance(module, nn.BatchNorm1d)]
    momenta = [norm.momentum for norm in norms]
    model.eval()
    for norm in norms:
        norm.train().reset_running_stats()
        norm.momentum = None  # cumulative: every batch counts the same
    with torch.no_grad():
        for part in parts:
            model(*to_tensors(model, model.inputs(samples, part, points, rng)))
    for norm, momentum in zip(norms, momenta, strict=True):
        norm.eval().momentum = momentum
