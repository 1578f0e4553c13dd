"""Training by the KL divergence to the labels: Adam with AMSGrad, early stopping, the best weights."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
import torch
from torch import Tensor, nn
from tqdm import tqdm

from pointnetkl.models import model, point_mlp
from pointnetkl.models.model import Model
from pointnetkl.models.samples import Samples
from pointnetkl.training import batch_norm, device, loss
from pointnetkl.training.checkpoint import Checkpoint
from pointnetkl.training.settings import KINDS, CloudSettings, Settings
from pointnetkl.workflow.errors import PointNetKLError

__all__ = ["KINDS", "CloudSettings", "Outcome", "Settings", "TrainingError", "finish", "predict", "train"]

# Streams of random numbers, so that validating more often changes no training batch.
_BATCHES, _VALIDATION, _STATISTICS = 1, 2, 3
_VALUES = ("step", "best_step", "rows", "losses", "gradients", "best_weights")  # of _Run, that a checkpoint holds

# of the history: training is the mean loss since the row before, validation that of the row's weights (nats); then the
# median and the largest norm of the gradient since the row before, as it was before it was shortened
COLUMNS = ["step", "training", "validation", "gradient_median", "gradient_largest"]


class TrainingError(PointNetKLError):
    """Training has failed."""


@dataclass(frozen=True)
class Outcome:
    """How training went; the model holds the best weights."""

    history: pd.DataFrame  # of COLUMNS, a row for each validation
    best_step: int  # 0: nothing was better than the start
    steps: int


def train(
    untrained: Model,
    training: Samples,
    validation: Samples,
    settings: Settings,
    checkpoint: Checkpoint | None = None,
    watch: Callable[[pd.DataFrame], None] = lambda history: None,
) -> Outcome:
    """Train the model on its device, give it the weights with the best validation, and return how training went.

    `checkpoint` keeps the state from time to time and at the end, and a second try or one of more steps goes on from
    there; `watch` gets the history after every new row.

    Raises:
        TrainingError: the loss is not a number.
    """
    run = _Run(untrained, training, validation, settings)
    kept = checkpoint.load() if checkpoint else None
    if kept and kept["values"]["step"] <= settings.steps:
        run.restore(kept)
    else:
        run.begin()
    watch(run.history())
    every = settings.validate_every if settings.early_stopping == "whole" else 1
    bar = tqdm(initial=run.step, total=settings.steps, desc="train", unit="step", mininterval=0.5, dynamic_ncols=True)
    while run.step < settings.steps and run.step - run.best_step < settings.patience * every:
        run.advance()
        bar.update()
        if run.step % every == 0 or run.step == settings.steps:
            run.judge()
            watch(run.history())
            bar.set_postfix_str(run.last_row())
        if checkpoint:
            checkpoint.offer(run.state)
    bar.close()
    if checkpoint and run.step == settings.steps and run.step % every == 0:  # a longer training has this row too
        checkpoint.keep(run.state())
    untrained.load_state_dict(run.best_weights)
    return Outcome(run.history(), run.best_step, run.step)


class _Run:
    """The state that training changes, which is what a checkpoint holds."""

    def __init__(self, untrained: Model, training: Samples, validation: Samples, settings: Settings) -> None:
        self.model, self.training, self.validation, self.settings = untrained, training, validation, settings
        self.points = _points(settings)
        processor = next(untrained.parameters()).device
        self.processor, self.low = processor, device.low_precision(processor)
        self.precision = "float32"
        if isinstance(settings, CloudSettings) and processor.type == "cpu":
            self.precision = settings.precision
        self.optimiser = torch.optim.Adam(
            untrained.parameters(), settings.learning_rate, weight_decay=settings.weight_decay, amsgrad=True, fused=True
        )
        self.scaler = torch.amp.GradScaler(processor.type, enabled=self.low is torch.float16)
        self.rng = np.random.default_rng([settings.seed, _BATCHES])
        self.step = self.best_step = 0
        self.rows: list[tuple[int | float, ...]] = []
        self.losses: list[float] = []  # since the last row
        self.gradients: list[float] = []  # their norms, likewise
        self.best_weights: dict[str, Tensor] = {}

    def begin(self) -> None:
        """Validate the start as well: a model that never beats the mean label stays the mean label."""
        self.losses.append(_validate(self.model, self.training, self.training, self.settings, 0))
        self.judge()

    def advance(self) -> None:
        """Take one step of the optimiser."""
        self.model.train()
        point_mlp.search_in(self.model, self.precision)
        indices = self.rng.integers(len(self.training), size=self.settings.batch)
        with torch.autocast(self.processor.type, self.low, enabled=self.low is not None):
            floor_m2 = self.settings.floor_m2
            mean = loss.divergences(self.model, self.training, indices, self.points, floor_m2, self.rng).mean()
        self.step += 1
        self.losses.append(_finite(mean.item(), self.step))
        self.optimiser.zero_grad()
        with point_mlp.matrix_products(self.precision):
            self.scaler.scale(mean).backward()  # type: ignore[no-untyped-call]
        self.scaler.unscale_(self.optimiser)
        # AMSGrad remembers the largest gradient for good: one wild label would make every later step short
        gradient = nn.utils.clip_grad_norm_(self.model.parameters(), self.settings.gradient_norm)
        self.gradients.append(gradient.item())
        self.scaler.step(self.optimiser)
        self.scaler.update()

    def judge(self) -> None:
        """Add a row of the history, and keep the weights if no earlier ones did as well in validation."""
        score = _validate(self.model, self.training, self.validation, self.settings, self.step)
        if not self.rows or score < min(row[2] for row in self.rows):
            self.best_step = self.step
            self.best_weights = {name: tensor.clone() for name, tensor in self.model.state_dict().items()}
        norms = (np.median(self.gradients), np.max(self.gradients)) if self.gradients else (np.nan, np.nan)
        self.rows.append((self.step, float(np.mean(self.losses)), score, *map(float, norms)))
        self.losses.clear()
        self.gradients.clear()

    def history(self) -> pd.DataFrame:
        """Return the rows as a table."""
        return pd.DataFrame(self.rows, columns=COLUMNS)

    def last_row(self) -> str:
        """Return the last row as the progress bar shows it."""
        _, training, validation, *_ = self.rows[-1]
        return f"training {training:.3f}, validation {validation:.3f}, best at step {self.best_step}"

    def state(self) -> dict[str, Any]:
        """Return the state, as plain values and tensors."""
        return {
            "parts": {name: getattr(self, name).state_dict() for name in ("model", "optimiser", "scaler")},
            "values": {name: getattr(self, name) for name in _VALUES},
            "rng": self.rng.bit_generator.state,
            "torch_rng": device.rng_states(self.processor),
        }

    def restore(self, kept: dict[str, Any]) -> None:
        """Go back to what `state` returned."""
        for name, part in kept["parts"].items():
            getattr(self, name).load_state_dict(part)
        for name, value in kept["values"].items():
            setattr(self, name, value)
        self.rng.bit_generator.state = kept["rng"]
        device.set_rng_states(self.processor, kept["torch_rng"])


def finish(trained: Model, training: Samples, settings: Settings) -> None:
    """Take a trained model's batch-norm statistics from whole clouds, as it will see them; leave it in evaluation.

    The largest of 2000 points' features is larger than that of 256, so statistics of thinned clouds do not fit.
    """
    _take_statistics(trained, training, settings, int(np.median([len(cloud) for cloud in training.clouds])))


def predict(trained: Model, samples: Samples) -> np.ndarray:
    """Return Q (k, M, M) in m^2 of whole clouds, one at a time."""
    trained.eval()
    rng = np.random.default_rng(0)  # nothing is drawn from it, as all points are seen
    inputs = (trained.inputs(samples, np.array([i]), None, rng) for i in range(len(samples)))
    return np.concatenate([model.predict(trained, arrays) for arrays in inputs])


def _take_statistics(trained: Model, training: Samples, settings: Settings, points: int | None) -> None:
    """Put a model in evaluation mode; batch norms, which models without clouds have not, take new statistics."""
    trained.eval()
    if isinstance(settings, CloudSettings):
        point_mlp.search_in(trained, "float32")  # as evaluation, which takes the very largest
        rng = np.random.default_rng([settings.seed, _STATISTICS])
        indices = rng.permutation(len(training))[: settings.statistics_batches * settings.statistics_batch]
        batch_norm.take_statistics(trained, training, _parts(indices, settings.statistics_batch), points, rng)


def _validate(trained: Model, training: Samples, validation: Samples, settings: Settings, step: int) -> float:
    """Return the mean loss over validation submaps; the whole set has the same points each time."""
    points = _points(settings)
    if settings.early_stopping == "paper":
        trained.eval()
        rng = np.random.default_rng([settings.seed, _VALIDATION, step])
        indices = rng.integers(len(validation), size=settings.batch)
    else:
        _take_statistics(trained, training, settings, points)
        rng = np.random.default_rng([settings.seed, _VALIDATION])
        indices = np.arange(len(validation))
    parts = _parts(indices, settings.batch)
    with torch.no_grad():
        losses = [loss.divergences(trained, validation, part, points, settings.floor_m2, rng) for part in parts]
    return float(torch.cat(losses).mean())


def _points(settings: Settings) -> int | None:
    """Return how many points of each submap training draws; None: the model takes no points."""
    return settings.points if isinstance(settings, CloudSettings) else None


def _parts(indices: np.ndarray, size: int) -> list[np.ndarray]:
    """Return indices in parts of about equal length, none longer than `size`."""
    return np.array_split(indices, -(-len(indices) // size))


def _finite(value: float, step: int) -> float:
    if not np.isfinite(value):
        raise TrainingError(f"step {step}: the loss is {value}; lower learning_rate or raise floor_m2 of its train")
    return value
