"""How a model is trained: its `train` in section `models` of the parameters, a class for each kind of model."""

from dataclasses import dataclass

from pointnetkl.workflow import parameters


@dataclass(frozen=True)
class Settings:
    """How a model of any kind is trained.

    Raises:
        ValueError: a number is out of its range.
    """

    seed: int
    device: str  # auto: a GPU where there is one; cpu; cuda
    threads: int  # of a CPU, among which a sum is shared: their number changes its last bits
    steps: int  # at most
    batch: int  # submaps a step, drawn with replacement
    learning_rate: float
    weight_decay: float  # L2, added to the gradient
    gradient_norm: float  # a longer gradient is shortened to this
    floor_m2: float  # added to the variances of label and answer alike, before they are compared
    validation_share: float
    validation_blocks: int  # of consecutive submaps, in each survey
    validate_every: int  # steps
    patience: int  # validations without a better one, before training stops
    early_stopping: str  # whole: on the whole validation set; paper: on a random batch of it, after every step

    def __post_init__(self) -> None:
        """Refuse values out of their range."""
        parameters.require_seed(self.seed)
        parameters.require_positive(self, "threads", "steps", "learning_rate", "gradient_norm")
        parameters.require_positive(self, "validation_blocks", "validate_every", "patience")
        _require_pairs(self, "batch")
        if not 0 < self.validation_share < 1:
            raise ValueError(f"validation_share is {self.validation_share:g}, must be between 0 and 1")
        for name in ("weight_decay", "floor_m2"):
            if getattr(self, name) < 0:
                raise ValueError(f"{name} is {getattr(self, name):g}, must not be negative")
        _require_one_of(self, "early_stopping", "whole", "paper")
        _require_one_of(self, "device", "auto", "cpu", "cuda")


@dataclass(frozen=True)
class CloudSettings(Settings):
    """How a model is trained that sees a submap's points through batch norms.

    Raises:
        ValueError: a number is out of its range.
    """

    points: int  # of each submap, drawn anew
    precision: str  # float32, or bfloat16: a CPU may round so in searches of the largest and in going backward
    statistics_batches: int  # of so many submaps, whose means and variances a batch norm has in evaluation
    statistics_batch: int

    def __post_init__(self) -> None:
        """Refuse values out of their range."""
        super().__post_init__()
        parameters.require_positive(self, "points", "statistics_batches")
        _require_pairs(self, "statistics_batch")
        _require_one_of(self, "precision", "float32", "bfloat16")


# By the kinds of models.model_file.KINDS.
KINDS: dict[str, type[Settings]] = {"pointnetkl": CloudSettings, "mean_field": Settings}


def _require_pairs(settings: Settings, name: str) -> None:
    if getattr(settings, name) < 2:
        raise ValueError(f"{name} is {getattr(settings, name)}, must be at least 2: a batch norm needs two submaps")


def _require_one_of(settings: Settings, name: str, *values: str) -> None:
    if getattr(settings, name) not in values:
        raise ValueError(f"{name} is {getattr(settings, name)!r}, must be one of {', '.join(values)}")
