"""Training by the KL divergence to the labels: Adam with AMSGrad, early stopping, the best weights."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
import torch
from torch import Tensor, nn
from tqdm import tqdm

from pointnetkl.models import model
from pointnetkl.models.model import Model
from pointnetkl.models.samples import Samples
from pointnetkl.training import batch_norm, device, loss
from pointnetkl.training.checkpoint import Checkpoint
from pointnetkl.workflow import parameters
from pointnetkl.workflow.errors import PointNetKLError

# Streams of random numbers, so that validating more often changes no training batch.
_BATCHES, _VALIDATION, _STATISTICS = 1, 2, 3


class TrainingError(PointNetKLError):
    """Training has failed."""


@dataclass(frozen=True)
class Settings:
    """How a model is trained: its `train` in section `models` of the parameters.

    Raises:
        ValueError: a number is out of its range.
    """

    seed: int
    device: str  # auto: a GPU where there is one; cpu; cuda
    threads: int  # of a CPU, among which a sum is shared: their number changes its last bits
    steps: int  # at most
    batch: int  # submaps a step, drawn with replacement
    points: int  # of each of them, drawn anew
    learning_rate: float
    weight_decay: float  # L2, added to the gradient
    gradient_norm: float  # a longer gradient is shortened to this
    floor_m2: float  # added to the variances of label and answer alike, before they are compared
    validation_share: float
    validation_blocks: int  # of consecutive submaps, in each survey
    validate_every: int  # steps
    patience: int  # validations without a better one, before training stops
    early_stopping: str  # whole: on the whole validation set; paper: on a random batch of it, after every step
    statistics_batches: int  # of so many submaps, whose means and variances a batch norm has in evaluation
    statistics_batch: int

    def __post_init__(self) -> None:
        """Refuse what cannot train."""
        parameters.require_seed(self.seed)
        parameters.require_positive(self, "threads", "steps", "points", "learning_rate", "gradient_norm")
        parameters.require_positive(self, "validation_blocks", "validate_every", "patience", "statistics_batches")
        for name in ("batch", "statistics_batch"):
            if getattr(self, name) < 2:
                raise ValueError(f"{name} is {getattr(self, name)}, must be at least 2: a batch norm needs two submaps")
        if not 0 < self.validation_share < 1:
            raise ValueError(f"validation_share is {self.validation_share:g}, must be between 0 and 1")
        for name in ("weight_decay", "floor_m2"):
            if getattr(self, name) < 0:
                raise ValueError(f"{name} is {getattr(self, name):g}, must not be negative")
        for name, known in (("early_stopping", ("whole", "paper")), ("device", ("auto", "cpu", "cuda"))):
            if getattr(self, name) not in known:
                raise ValueError(f"{name} is {getattr(self, name)!r}, must be one of {', '.join(known)}")


@dataclass(frozen=True)
class Outcome:
    """How training went; the model holds the best weights."""

    history: pd.DataFrame  # a row a validation: step, training (mean since the row before), validation; nats
    best_step: int  # 0: nothing was better than the start
    steps: int


def train(
    untrained: Model,
    training: Samples,
    validation: Samples,
    chosen: Settings,
    checkpoint: Checkpoint | None = None,
    watch: Callable[[pd.DataFrame], None] = lambda history: None,
) -> Outcome:
    """Train the model, where it is, give it the weights that did best in validation, and return how it went.

    `checkpoint` keeps the state on the way and gives it back to a second try; `watch` gets the history at every row.

    Raises:
        TrainingError: the loss is not a number.
    """
    run = _Run(untrained, training, validation, chosen)
    if checkpoint and (kept := checkpoint.load()):
        run.restore(kept)
    else:
        run.begin()
    watch(run.history())
    every = chosen.validate_every if chosen.early_stopping == "whole" else 1
    bar = tqdm(initial=run.step, total=chosen.steps, desc="train", unit="step", mininterval=0.5, dynamic_ncols=True)
    while run.step < chosen.steps and run.step - run.best_step < chosen.patience * every:
        run.advance()
        bar.update()
        if run.step % every == 0 or run.step == chosen.steps:
            run.judge()
            watch(run.history())
            bar.set_postfix_str(run.last_row())
        if checkpoint:
            checkpoint.offer(run.state)
    bar.close()
    untrained.load_state_dict(run.best_weights)
    return Outcome(run.history(), run.best_step, run.step)


class _Run:
    """All that a training changes on its way, and so all that a checkpoint holds."""

    def __init__(self, untrained: Model, training: Samples, validation: Samples, chosen: Settings) -> None:
        self.model, self.training, self.validation, self.chosen = untrained, training, validation, chosen
        where = next(untrained.parameters()).device
        self.where, self.low = where, device.low_precision(where)
        self.optimiser = torch.optim.Adam(
            untrained.parameters(), chosen.learning_rate, weight_decay=chosen.weight_decay, amsgrad=True, fused=True
        )
        self.scaler = torch.amp.GradScaler(where.type, enabled=self.low is torch.float16)
        self.rng = np.random.default_rng([chosen.seed, _BATCHES])
        self.step = self.best_step = 0
        self.rows: list[tuple[int, float, float]] = []
        self.losses: list[float] = []  # since the last row
        self.best_weights: dict[str, Tensor] = {}

    def begin(self) -> None:
        """Judge the start as well: what never gets better than a constant stays one."""
        self.losses.append(_validate(self.model, self.training, self.training, self.chosen, 0))
        self.judge()

    def advance(self) -> None:
        """Take one step of the optimiser."""
        self.model.train()
        which = self.rng.integers(len(self.training), size=self.chosen.batch)
        with torch.autocast(self.where.type, self.low, enabled=self.low is not None):
            points, floor = self.chosen.points, self.chosen.floor_m2
            mean = loss.divergences(self.model, self.training, which, points, floor, self.rng).mean()
        self.step += 1
        self.losses.append(_finite(mean.item(), self.step))
        self.optimiser.zero_grad()
        self.scaler.scale(mean).backward()  # type: ignore[no-untyped-call]
        self.scaler.unscale_(self.optimiser)
        # AMSGrad remembers the largest gradient for good: one wild label would make every later step short
        nn.utils.clip_grad_norm_(self.model.parameters(), self.chosen.gradient_norm)
        self.scaler.step(self.optimiser)
        self.scaler.update()

    def judge(self) -> None:
        """Add a row of the history, and keep the weights if no earlier ones did as well in validation."""
        score = _validate(self.model, self.training, self.validation, self.chosen, self.step)
        if not self.rows or score < min(row[2] for row in self.rows):
            self.best_step = self.step
            self.best_weights = {name: tensor.clone() for name, tensor in self.model.state_dict().items()}
        self.rows.append((self.step, float(np.mean(self.losses)), score))
        self.losses.clear()

    def history(self) -> pd.DataFrame:
        """Return the rows as a table."""
        return pd.DataFrame(self.rows, columns=["step", "training", "validation"])

    def last_row(self) -> str:
        """Return the last row as the progress bar tells it."""
        _, training, validation = self.rows[-1]
        return f"training {training:.3f}, validation {validation:.3f}, best at step {self.best_step}"

    def state(self) -> dict[str, Any]:
        """Return everything, as plain values and tensors."""
        return {
            "parts": {name: getattr(self, name).state_dict() for name in ("model", "optimiser", "scaler")},
            "values": {name: getattr(self, name) for name in ("step", "best_step", "rows", "losses", "best_weights")},
            "rng": self.rng.bit_generator.state,
            "torch_rng": device.rng_states(self.where),
        }

    def restore(self, kept: dict[str, Any]) -> None:
        """Go back to what `state` returned."""
        for name, part in kept["parts"].items():
            getattr(self, name).load_state_dict(part)
        for name, value in kept["values"].items():
            setattr(self, name, value)
        self.rng.bit_generator.state = kept["rng"]
        device.set_rng_states(self.where, kept["torch_rng"])


def finish(trained: Model, training: Samples, chosen: Settings) -> None:
    """Take a trained model's batch-norm statistics from whole clouds, as it will see them; leave it in evaluation.

    The largest of 2000 points' features is larger than that of 256, so statistics of thinned clouds do not fit.
    """
    _take_statistics(trained, training, chosen, int(np.median([len(cloud) for cloud in training.clouds])))


def predict(trained: Model, samples: Samples) -> np.ndarray:
    """Return Q (k, M, M) in m^2 of whole clouds, one at a time."""
    trained.eval()
    rng = np.random.default_rng(0)  # asked for nothing, as all points are seen
    each = (trained.inputs(samples, np.array([i]), None, rng) for i in range(len(samples)))
    return np.concatenate([model.predict(trained, inputs) for inputs in each])


def _take_statistics(of: Model, training: Samples, chosen: Settings, points: int) -> None:
    rng = np.random.default_rng([chosen.seed, _STATISTICS])
    which = rng.permutation(len(training))[: chosen.statistics_batches * chosen.statistics_batch]
    batch_norm.take_statistics(of, training, _parts(which, chosen.statistics_batch), points, rng)


def _validate(of: Model, training: Samples, validation: Samples, chosen: Settings, step: int) -> float:
    """Return the mean loss over validation submaps; the whole set has the same points each time."""
    if chosen.early_stopping == "paper":
        of.eval()
        rng = np.random.default_rng([chosen.seed, _VALIDATION, step])
        which = rng.integers(len(validation), size=chosen.batch)
    else:
        _take_statistics(of, training, chosen, chosen.points)
        rng = np.random.default_rng([chosen.seed, _VALIDATION])
        which = np.arange(len(validation))
    parts = _parts(which, chosen.batch)
    with torch.no_grad():
        each = [loss.divergences(of, validation, part, chosen.points, chosen.floor_m2, rng) for part in parts]
    return float(torch.cat(each).mean())


def _parts(indices: np.ndarray, size: int) -> list[np.ndarray]:
    """Return indices in parts of about equal length, none longer than `size`."""
    return np.array_split(indices, -(-len(indices) // size))


def _finite(value: float, step: int) -> float:
    if not np.isfinite(value):
        raise TrainingError(f"step {step}: the loss is {value}; lower learning_rate or raise floor_m2 of its train")
    return value
