"""Seconds per submap of every method, on one thread, over submaps of the paper's size (Table III)."""
# ruff: noqa: E402

import os

# before NumPy, numba and torch are imported, which read these once
for library in ("OMP", "OPENBLAS", "MKL", "NUMBA"):
    os.environ[f"{library}_NUM_THREADS"] = "1"

import argparse
from pathlib import Path

import numpy as np

from pointnetkl import simulation
from pointnetkl.methods import estimated, runtime, sampled
from pointnetkl.methods.closed_forms.self_registration import SelfRegistration
from pointnetkl.methods.fitted import constant, learned
from pointnetkl.models import trained
from pointnetkl.registration import gicp, monte_carlo
from pointnetkl.registration.covariance import catalogue
from pointnetkl.registration.covariance.method import Method
from pointnetkl.simulation import seabed
from pointnetkl.surveys.submap import Submap
from pointnetkl.workflow import artifacts, command, parameters


def main(arguments: argparse.Namespace) -> None:
    """Time every method, write the means and standard deviations and print them."""
    chosen = parameters.read(arguments.params, "time", runtime.Settings)
    terrain = parameters.read(arguments.params, f"simulate.{chosen.terrain}.terrain", seabed.Settings)
    submaps = [draw(chosen, terrain, number) for number in range(chosen.submaps)]
    timings = {m.name: runtime.measure(m, submaps) for m in methods(arguments, chosen)}
    for name, each in timings.items():
        print(f"{name}: {each.mean_s:.3g} s +- {each.std_s:.2g} s a submap")
    entries = {name: parameters.as_metadata(each) for name, each in timings.items()}
    machine = {**runtime.machine(), "params": parameters.as_metadata(chosen)}
    artifacts.write_json(arguments.runtime, {**entries, "machine": machine})


def draw(chosen: runtime.Settings, terrain: seabed.Settings, number: int) -> Submap:
    """Return one of the submaps to time on."""
    rng = np.random.default_rng([chosen.seed, number])
    return runtime.submap(simulation.patch(terrain, chosen.points, chosen.spacing_m, rng), number)


def methods(arguments: argparse.Namespace, chosen: runtime.Settings) -> list[Method]:
    """Return every method; the constant's value does not matter to its time."""
    label = parameters.read(arguments.params, "label", monte_carlo.Settings)
    registration = parameters.read(arguments.params, "registration", gicp.Settings)
    seed = parameters.read(arguments.params, "predict", learned.Settings).seed
    fits = learned.read(arguments.fits, registration.dimensions)
    return [
        sampled.Sampled(catalogue.MONTE_CARLO, chosen.runs, chosen.seed, label, registration),
        constant.Constant(catalogue.CONSTANT, np.eye(registration.dimensions)),
        *estimated.without_labels(
            parameters.read(arguments.params, "estimate", estimated.Settings), label, registration
        ),
        *learned.methods(fits, SelfRegistration(seed, label, registration)),
        *trained.load_all(arguments.models, label, registration),
    ]


if __name__ == "__main__":
    parser = command.parser(__doc__)
    parser.add_argument("--models", type=Path, nargs="+", required=True)
    parser.add_argument("--fits", type=Path, required=True)
    parser.add_argument("--runtime", type=Path, required=True)
    command.run(main, parser)
