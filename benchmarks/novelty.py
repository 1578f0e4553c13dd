"""How often a model's flag for foreign submaps is right: on surveys it has not seen, and on submaps made foreign."""

import argparse
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from pointnetkl import estimator
from pointnetkl.registration.covariance import gaussian, table
from pointnetkl.reporting import text_table
from pointnetkl.surveys import submap
from pointnetkl.training import dataset
from pointnetkl.workflow import artifacts, command, parameters
from pointnetkl.workflow.errors import PointNetKLError

_SPIKES = 0.01, 10.0  # share of the points, metres
_SEEN_FROM = 4  # every so many-th submap is made foreign

CHANGES: dict[str, Callable[[np.ndarray, np.random.Generator], np.ndarray]] = {
    "points three times as far apart": lambda p, rng: rng.permutation(p)[: len(p) // 9],
    "four times as long and wide": lambda p, rng: p * [4, 4, 1],
    "heights twenty times as high": lambda p, rng: (p - p.mean(axis=0)) * [1, 1, 20],
    "a strip 6 m wide": lambda p, rng: p[np.abs(p[:, 0] - np.median(p[:, 0])) < 3],
    "half of it": lambda p, rng: p[p[:, 0] > np.median(p[:, 0])],
    "spikes of 10 m on 1 % of the points": lambda p, rng: (
        p + np.outer(rng.random(len(p)) < _SPIKES[0], [0, 0, _SPIKES[1]])
    ),
}


def main(arguments: argparse.Namespace) -> None:
    """Print a table of surveys and one of changes, as CSV."""
    floor = parameters.read(arguments.params, "report.kl_floor_m2", float)
    model = estimator.CovarianceEstimator.load(arguments.model)
    surveys = {name: read(arguments.data, name) for name in arguments.surveys}
    judged = {name: [model.judge(points) for points in clouds] for name, (clouds, _) in surveys.items()}
    rows = [row(name, judged[name], surveys[name][1], floor) for name in surveys]
    changed = [
        {"survey": name, "flagged": flagged(model, clouds[::_SEEN_FROM], change), "of": what}
        for name, (clouds, _) in surveys.items()
        for what, change in CHANGES.items()
    ]
    for each in (rows, pd.DataFrame(changed).pivot(index="of", columns="survey", values="flagged").reset_index()):
        print(text_table.csv(pd.DataFrame(each)))


def read(data: Path, name: str) -> tuple[list[np.ndarray], np.ndarray]:
    """Return a survey's submaps and their labels (k, M, M)."""
    submaps = submap.from_table(name, artifacts.read_table(data / "test" / name / "submaps.parquet", submap.POINTS))
    labels = artifacts.read_table(data / "test" / name / "labels.parquet", dataset.LABEL, also=table.YAW)
    return [each.points for each in submaps], table.to_matrices(labels)


def row(name: str, judged: Sequence[estimator.Prediction], labels: np.ndarray, floor: float) -> dict[str, object]:
    """Return the share that is flagged, and the mean KL (nats) of those that are and of those that are not."""
    pair = (gaussian.with_floor(q, floor) for q in (labels, np.stack([each.covariance for each in judged])))
    kl, flag = gaussian.kl_divergence(*pair), np.array([each.is_novel for each in judged])
    means = {
        told: float(kl[which].mean()) if which.any() else None
        for told, which in (("kl_flagged", flag), ("kl_others", ~flag))
    }
    return {"survey": name, "submaps": len(flag), "flagged": float(flag.mean()), **means}


def flagged(
    model: estimator.CovarianceEstimator,
    clouds: Sequence[np.ndarray],
    change: Callable[[np.ndarray, np.random.Generator], np.ndarray],
) -> float:
    """Return the share of changed submaps that are flagged, or refused altogether."""
    return float(
        np.mean([_flagged(model, change(points, np.random.default_rng(i))) for i, points in enumerate(clouds)])
    )


def _flagged(model: estimator.CovarianceEstimator, points: np.ndarray) -> bool:
    try:
        return model.judge(points).is_novel
    except PointNetKLError:
        return True


if __name__ == "__main__":
    parser = command.parser(__doc__)
    parser.add_argument("surveys", nargs="+", help="with submaps and labels below --data")
    parser.add_argument("--model", type=Path, default=Path("models/network.pt"))
    parser.add_argument("--data", type=Path, default=Path("data"))
    command.run(main, parser)
