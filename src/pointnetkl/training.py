"""Training by the KL divergence to the labels: Adam with AMSGrad, early stopping, the best weights."""

import copy
from dataclasses import dataclass

import numpy as np
import pandas as pd
import torch
from torch import Tensor, nn
from tqdm import tqdm

from pointnetkl import dataset, network, settings
from pointnetkl.covariance import gaussian
from pointnetkl.dataset import Samples
from pointnetkl.errors import PointNetKLError

# Streams of random numbers, so that validating more often changes no training batch.
_BATCHES, _VALIDATION, _STATISTICS = 1, 2, 3


class TrainingError(PointNetKLError):
    """Training has failed."""


@dataclass(frozen=True)
class Settings:
    """Section `train` of the parameters.

    Raises:
        ValueError: a number is out of its range.
    """

    seed: int
    threads: int  # among which a sum is shared: their number changes its last bits
    steps: int  # at most
    batch: int  # submaps a step, drawn with replacement
    points: int  # of each of them, drawn anew
    learning_rate: float
    weight_decay: float  # L2, added to the gradient
    label_floor_m2: float  # added to a label's variances before it is learned
    validation_share: float
    validation_blocks: int  # of consecutive submaps, in each survey
    validate_every: int  # steps
    patience: int  # validations without a better one, before training stops
    early_stopping: str  # whole: on the whole validation set; paper: on a random batch of it, after every step
    statistics_batches: int  # of so many submaps, whose means and variances a batch norm has in evaluation
    statistics_batch: int

    def __post_init__(self) -> None:
        """Refuse what cannot train."""
        settings.require_seed(self.seed)
        settings.require_positive(self, "threads", "steps", "points", "learning_rate", "validation_blocks")
        settings.require_positive(self, "validate_every", "patience", "statistics_batches")
        for name in ("batch", "statistics_batch"):
            if getattr(self, name) < 2:
                raise ValueError(f"{name} is {getattr(self, name)}, must be at least 2: a batch norm needs two submaps")
        if not 0 < self.validation_share < 1:
            raise ValueError(f"validation_share is {self.validation_share:g}, must be between 0 and 1")
        if min(self.weight_decay, self.label_floor_m2) < 0:
            raise ValueError(
                f"weight_decay is {self.weight_decay:g} and label_floor_m2 {self.label_floor_m2:g},"
                " must not be negative"
            )
        if self.early_stopping not in ("whole", "paper"):
            raise ValueError(f"early_stopping is {self.early_stopping!r}, must be whole or paper")


@dataclass(frozen=True)
class Outcome:
    """How training went; the model holds the best weights."""

    history: pd.DataFrame  # a row a validation: step, training (mean since the row before), validation; nats
    best_step: int  # 0: nothing was better than the start
    steps: int


def prepare(seed: int, threads: int) -> None:
    """Make torch give the same bits every time: its generator, how it shares sums out, its choice of algorithms."""
    torch.manual_seed(seed)
    torch.set_num_threads(threads)
    torch.use_deterministic_algorithms(True)
    # else every new tensor is filled with NaN first, a fifth of the time; nothing here reads what it has not written
    torch.utils.deterministic.fill_uninitialized_memory = False  # type: ignore[attr-defined]


def start_at_mean(model: network.PointNetKL, training: Samples, floor: float) -> None:
    """Make the untrained model answer with the mean label, which of all constants has the least mean KL.

    From the random weights' 1 m^2 a tenth of the demo's steps would only get here. The paper does not say how
    it starts.
    """
    q = gaussian.with_floor(training.label, floor).mean(axis=0)
    factor = np.linalg.cholesky(q)
    lower = factor / np.diag(factor)
    numbers = [*lower[np.tril_indices(len(q), -1)], *2 * np.log(np.diag(factor))]
    nn.init.zeros_(model.last.weight)
    with torch.no_grad():
        model.last.bias.copy_(torch.tensor(numbers))


def train(model: network.PointNetKL, training: Samples, validation: Samples, chosen: Settings) -> Outcome:
    """Train the model, give it the weights that did best in validation, and return how it went.

    Raises:
        TrainingError: the loss is not a number.
    """
    optimiser = torch.optim.Adam(
        model.parameters(), chosen.learning_rate, weight_decay=chosen.weight_decay, amsgrad=True, fused=True
    )
    rng = np.random.default_rng([chosen.seed, _BATCHES])
    every = chosen.validate_every if chosen.early_stopping == "whole" else 1
    rows: list[tuple[int, float, float]] = []
    losses: list[float] = []
    # the start counts as well: what never gets better than a constant stays one
    best, best_step = _validate(model, training, validation, chosen, 0), 0
    best_weights = copy.deepcopy(model.state_dict())
    bar = tqdm(range(1, chosen.steps + 1), desc="train", unit="step", mininterval=0.5, dynamic_ncols=True)
    for step in bar:
        model.train()
        which = rng.integers(len(training), size=chosen.batch)
        loss = _divergences(model, training, which, chosen, rng).mean()
        optimiser.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        optimiser.step()
        losses.append(_finite(loss.item(), step))
        if step % every and step < chosen.steps:
            continue

        score = _validate(model, training, validation, chosen, step)
        rows.append((step, float(np.mean(losses)), score))
        losses.clear()
        if score < best:
            best, best_step, best_weights = score, step, copy.deepcopy(model.state_dict())
        bar.set_postfix(training=f"{rows[-1][1]:.3f}", validation=f"{score:.3f}", best=f"{best:.3f}")
        if step - best_step >= chosen.patience * every:
            break
    bar.close()
    model.load_state_dict(best_weights)
    return Outcome(pd.DataFrame(rows, columns=["step", "training", "validation"]), best_step, step)


def finish(model: network.PointNetKL, training: Samples, chosen: Settings) -> None:
    """Take a trained model's batch-norm statistics from whole clouds, as it will see them; leave it in evaluation.

    The largest of 2000 points' features is larger than that of 256, so statistics of thinned clouds do not fit.
    """
    whole = int(np.median([len(cloud) for cloud in training.clouds]))
    take_statistics(model, training, chosen, whole)


def take_statistics(model: network.PointNetKL, samples: Samples, chosen: Settings, points: int) -> None:
    """Replace batch-norm statistics by the average over a few large batches, and leave the model in evaluation mode.

    The running average that training keeps is of weights that have changed since, and of batches that miss the rare
    steep submap: deep layers multiply both errors, and exp(d) explodes. Dropout is off, as it is in evaluation.
    """
    rng = np.random.default_rng([chosen.seed, _STATISTICS])
    which = rng.permutation(len(samples))[: chosen.statistics_batches * chosen.statistics_batch]
    norms = [module for module in model.modules() if isinstance(module, nn.BatchNorm1d)]
    momenta = [norm.momentum for norm in norms]
    model.eval()
    for norm in norms:
        norm.train().reset_running_stats()
        norm.momentum = None  # cumulative: every batch counts the same
    with torch.no_grad():
        for part in _parts(which, chosen.statistics_batch):
            model(*_inputs(model, samples, part, points, rng))
    for norm, momentum in zip(norms, momenta, strict=True):
        norm.eval().momentum = momentum


def predict(model: network.PointNetKL, samples: Samples) -> np.ndarray:
    """Return Q (k, M, M) in m^2 of whole clouds, one at a time."""
    model.eval()
    pairs = zip(samples.clouds, samples.radius, strict=True)
    return np.stack([network.predict(model, cloud, radius) for cloud, radius in pairs])


def _validate(model: network.PointNetKL, training: Samples, validation: Samples, chosen: Settings, step: int) -> float:
    """Return the mean loss over validation submaps; the whole set has the same points each time."""
    if chosen.early_stopping == "paper":
        model.eval()
        rng = np.random.default_rng([chosen.seed, _VALIDATION, step])
        which = rng.integers(len(validation), size=chosen.batch)
    else:
        take_statistics(model, training, chosen, chosen.points)
        rng = np.random.default_rng([chosen.seed, _VALIDATION])
        which = np.arange(len(validation))
    with torch.no_grad():
        each = [_divergences(model, validation, part, chosen, rng) for part in _parts(which, chosen.batch)]
    return float(torch.cat(each).mean())


def _divergences(
    model: network.PointNetKL, samples: Samples, which: np.ndarray, chosen: Settings, rng: np.random.Generator
) -> Tensor:
    """Return KL(label + floor || prediction) of some submaps, seen by random points, (b,)."""
    factors = np.linalg.cholesky(gaussian.with_floor(samples.label[which], chosen.label_floor_m2))
    points, radius = _inputs(model, samples, which, chosen.points, rng)
    return network.kl_divergence(torch.from_numpy(factors).to(points), model(points, radius))


def _inputs(
    model: network.PointNetKL, samples: Samples, which: np.ndarray, points: int, rng: np.random.Generator
) -> tuple[Tensor, Tensor]:
    """Return random points of some submaps and their radii, where the model is."""
    where = next(model.parameters())
    clouds, radius = dataset.draw(samples, which, points, rng)
    return torch.from_numpy(clouds).to(where), torch.from_numpy(radius).to(where)


def _parts(which: np.ndarray, size: int) -> list[np.ndarray]:
    """Return indices in parts of about equal length, none longer than `size`."""
    return np.array_split(which, -(-len(which) // size))


def _finite(loss: float, step: int) -> float:
    if not np.isfinite(loss):
        raise TrainingError(f"step {step}: the loss is {loss}; lower train.learning_rate or raise train.label_floor_m2")
    return loss
