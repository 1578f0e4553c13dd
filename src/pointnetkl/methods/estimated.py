"""The methods that need only the submap, its labels or a few registrations; a new method is added by a line here."""

from dataclasses import dataclass

import pandas as pd

from pointnetkl.methods import labelled, sampled
from pointnetkl.methods.closed_forms import censi, hessian, mean_field, naive_gicp, unscented
from pointnetkl.methods.closed_forms.self_registration import SelfRegistration
from pointnetkl.methods.fitted import constant
from pointnetkl.registration import gicp, monte_carlo
from pointnetkl.registration.covariance import catalogue, table
from pointnetkl.registration.covariance.method import Method
from pointnetkl.workflow.parameters import require_seed
from pointnetkl.workflow.study import MOST_RUNS


@dataclass(frozen=True)
class Settings:
    """Section `estimate` of the parameters.

    Raises:
        ValueError: fewer than 3 registrations, whose covariance may be singular, too many, or the same number twice.
    """

    seed: int
    sampled_runs: list[int]  # registrations of each mc_<runs>

    def __post_init__(self) -> None:
        """Refuse values out of their range."""
        require_seed(self.seed)
        if min(self.sampled_runs, default=3) < 3 or len(set(self.sampled_runs)) < len(self.sampled_runs):
            raise ValueError(f"sampled_runs is {self.sampled_runs}, each must be at least 3 and stand once")
        if max(self.sampled_runs, default=0) > MOST_RUNS:
            raise ValueError(f"sampled_runs is {self.sampled_runs}, each must be at most {MOST_RUNS}")


def methods(
    labels: pd.DataFrame, settings: Settings, label: monte_carlo.Settings, registration: gicp.Settings
) -> list[Method]:
    """Return the methods for one survey, whose label table (label_table.LABELS) is given."""
    return [
        labelled.from_table(catalogue.MONTE_CARLO, labels),
        constant.mean(catalogue.CONSTANT, table.to_matrices(labels)),
        *without_labels(settings, label, registration),
    ]


def without_labels(settings: Settings, label: monte_carlo.Settings, registration: gicp.Settings) -> list[Method]:
    """Return those of the methods that no label is needed for."""
    setup = SelfRegistration(settings.seed, label, registration)
    return [
        naive_gicp.NaiveGicp(registration),
        naive_gicp.NaiveMeanCovariance(registration),
        hessian.Hessian(setup),
        censi.Censi(setup),
        unscented.Unscented(setup),
        mean_field.MeanField(label, registration),
        *(
            sampled.Sampled(catalogue.sampled(runs), runs, settings.seed, label, registration)
            for runs in settings.sampled_runs
        ),
    ]
