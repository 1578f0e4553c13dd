"""Would scrambled Sobol starts make a label cheaper? Its error with them against that with independent starts.

Of each survey some submaps, evenly spread, are registered `--repetitions` times `--runs` from starts of a scrambled
Sobol sequence, each time with another scrambling and other noise. The first 64, 128, ... runs are such a set as well.
What independent starts give follows from the same registrations, taken as one sample.

Printed for each kind of submap (by its label: flat, smaller eigenvalue above 1 m2; rugged, larger below 0.05 m2; mixed
otherwise), at each number of runs: `runs_needed`, the squared standard error with Sobol starts over that with
independent ones, mean over the three entries of the label in its own axes (1/3: a third of the runs give the same), and
the mean KL (nats, at 0.01 m2) from all runs to so many of them, with Sobol starts and with independent ones.
"""

import argparse
import functools
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.special import ndtri
from scipy.stats import qmc

from pointnetkl.registration import gicp, monte_carlo
from pointnetkl.registration.covariance import gaussian
from pointnetkl.surveys import submap
from pointnetkl.surveys.submap import Submap
from pointnetkl.workflow import compute, parameters
from pointnetkl.workflow import study as studies

_INDEPENDENT = 40  # sets of independent runs that the mean KL is over


def main(arguments: argparse.Namespace) -> None:
    """Register, and print a row for each kind of submap and number of runs."""
    settings = parameters.read(arguments.params, "label", monte_carlo.Settings)
    registration = parameters.read(arguments.params, "registration", gicp.Settings)
    submaps = [cloud for name in arguments.surveys for cloud in spread(arguments, name)]
    register = functools.partial(
        from_sobol, arguments.repetitions, arguments.runs, arguments.seed, settings, registration
    )
    errors = compute.over(register, submaps, "register")
    rows = pd.DataFrame([row for index, one in enumerate(errors) for row in judge(one, index, arguments.seed)])
    means = (
        rows.groupby(["kind", "runs"])
        .mean(numeric_only=True)
        .join(rows.groupby(["kind", "runs"]).size().rename("submaps"))
    )
    print(means.round(4).to_string())


def spread(arguments: argparse.Namespace, name: str) -> list[Submap]:
    """Return some of a survey's submaps, evenly spread along its track."""
    group = studies.survey(arguments.params, name).group
    submaps = list(submap.stream(name, arguments.data / group / name / "submaps.parquet"))
    return [submaps[i] for i in np.linspace(0, len(submaps) - 1, arguments.submaps).round().astype(int)]


def from_sobol(
    repetitions: int, runs: int, seed: int, settings: monte_carlo.Settings, registration: gicp.Settings, cloud: Submap
) -> np.ndarray:
    """Return errors (repetitions, runs, M) of registrations that start from scrambled Sobol sequences."""
    pair = monte_carlo.clouds(cloud, settings, registration)
    sigmas = monte_carlo.prior_sigmas(settings, registration.dimensions)
    errors = []
    for repetition in range(repetitions):
        rng = np.random.default_rng([seed, repetition, cloud.number])
        noise = gicp.Noise(settings.noise_sigma_m, int(rng.integers(1 << 63)), 0)
        uniform = qmc.Sobol(len(sigmas), scramble=True, rng=rng).random(runs)
        starts = ndtri(np.clip(uniform, 1e-12, 1 - 1e-12)) * sigmas
        errors.append(monte_carlo.register_perturbed(cloud, pair, starts, noise, settings, registration).errors)
    return np.stack(errors)


def judge(errors: np.ndarray, index: int, seed: int) -> Iterator[dict[str, float | str]]:
    """Yield a row for each number of runs, of one submap's errors (repetitions, runs, M)."""
    pooled = errors.reshape(-1, errors.shape[2])
    q = monte_carlo.covariance(pooled)
    values, axes = np.linalg.eigh(q[:2, :2])
    kind = "flat" if values[0] > 1 else "rugged" if values[1] < 0.05 else "mixed"
    rng = np.random.default_rng([seed, index])
    products = entries(errors[..., :2] @ axes)
    runs = 64
    while runs <= errors.shape[1]:
        with_sobol = products[:, :runs].mean(axis=1).var(axis=0, ddof=1)
        independent = entries(pooled[:, :2] @ axes).var(axis=0) / runs
        drawn = pooled[rng.integers(len(pooled), size=(_INDEPENDENT, runs))]
        yield {
            "kind": kind,
            "runs": runs,
            "runs_needed": float(np.mean(with_sobol / independent)),
            "kl_sobol": mean_kl(q, errors[:, :runs]),
            "kl_independent": mean_kl(q, drawn),
        }
        runs *= 2


def entries(errors: np.ndarray) -> np.ndarray:
    """Return the products of errors (..., 2) whose means are a covariance's entries: xx, xy, yy."""
    x, y = errors[..., 0], errors[..., 1]
    return np.stack([x * x, x * y, y * y], axis=-1)


def mean_kl(q: np.ndarray, errors: np.ndarray) -> float:
    """Return the mean KL from Q (M, M) to the labels of sets of errors (sets, runs, M), nats."""
    labels = np.stack([monte_carlo.covariance(one) for one in errors])
    return float(gaussian.divergence(np.broadcast_to(q, labels.shape), labels, gaussian.KL_FLOOR_M2).mean())


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("surveys", nargs="+", help="of section study, voxelised or not")
    parser.add_argument("--params", type=Path, default=Path("params.yaml"))
    parser.add_argument("--data", type=Path, default=Path("data"))
    parser.add_argument("--submaps", type=int, default=20, help="of each survey")
    parser.add_argument("--runs", type=int, default=512, help="of each repetition; a power of 2")
    parser.add_argument("--repetitions", type=int, default=8)
    parser.add_argument("--seed", type=int, default=7)
    main(parser.parse_args())
