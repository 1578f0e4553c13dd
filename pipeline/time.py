"""Seconds per submap of every method, on one thread, over submaps of the paper's size (Table III)."""
# ruff: noqa: E402

import os

# before NumPy, numba and torch are imported, which read these once
for library in ("OMP", "OPENBLAS", "MKL", "NUMBA"):
    os.environ[f"{library}_NUM_THREADS"] = "1"

import pointnetkl.workflow.blas  # noqa: F401 - before NumPy is loaded

# isort: split
import argparse
from pathlib import Path

import numpy as np

from pointnetkl import simulation
from pointnetkl.methods import estimated, runtime, sampled
from pointnetkl.methods.fitted import constant, learned
from pointnetkl.models import trained
from pointnetkl.registration.covariance import catalogue
from pointnetkl.registration.covariance.method import Method
from pointnetkl.simulation import seabed
from pointnetkl.surveys.submap import Submap
from pointnetkl.workflow import artifacts, command, parameters, study


def main(arguments: argparse.Namespace) -> None:
    """Time every method, write the means and standard deviations and print them."""
    settings = parameters.read(arguments.params, "time", runtime.Settings)
    terrain = parameters.read(arguments.params, f"simulate.{settings.terrain}.terrain", seabed.Settings)
    submaps = [draw(settings, terrain, number) for number in range(settings.submaps)]
    timings = {method.name: runtime.measure(method, submaps) for method in methods(arguments, settings)}
    for name, timing in timings.items():
        print(f"{name}: {timing.mean_s:.3g} s +- {timing.std_s:.2g} s a submap")
    entries = {name: parameters.as_metadata(timing) for name, timing in timings.items()}
    machine = {**runtime.machine(), "params": parameters.as_metadata(settings)}
    artifacts.write_json(arguments.runtime, {**entries, "machine": machine})


def draw(settings: runtime.Settings, terrain: seabed.Settings, number: int) -> Submap:
    """Return one of the submaps to time on."""
    rng = np.random.default_rng([settings.seed, number])
    return runtime.submap(simulation.patch(terrain, settings.points, settings.spacing_m, rng), number)


def methods(arguments: argparse.Namespace, settings: runtime.Settings) -> list[Method]:
    """Return every method; the constant's value does not matter to its time."""
    estimate = parameters.read(arguments.params, "estimate", estimated.Settings)
    seed = parameters.read(arguments.params, "predict", learned.Settings).seed
    fits = learned.read(arguments.fits)
    label, registration = fits.label, fits.registration
    paths = [arguments.models / f"{name}.pt" for name in study.read(arguments.params).models]
    return [
        sampled.Sampled(catalogue.MONTE_CARLO, settings.runs, settings.seed, label, registration),
        constant.Constant(catalogue.CONSTANT, np.eye(registration.dimensions)),
        *estimated.without_labels(estimate, label, registration),
        *learned.methods(fits, seed),
        *trained.load_all(paths, label, registration),
    ]


if __name__ == "__main__":
    parser = command.parser(__doc__)
    parser.add_argument("--models", type=Path, required=True)
    parser.add_argument("--fits", type=Path, required=True)
    parser.add_argument("--runtime", type=Path, required=True)
    command.run(main, parser)
