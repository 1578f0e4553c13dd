"""Compile the kernels that Numba keeps on disk, as the last step of set-up: the first run then has none to wait for.

Each is called once, on a toy, as the stages call it. Without this step the first stage that needs one compiles it.
"""

import pointnetkl.workflow.blas  # noqa: F401 - before NumPy is loaded

# isort: split
import dataclasses
import sys
from pathlib import Path

import numpy as np
import torch

from pointnetkl import simulation
from pointnetkl.models import mean_field
from pointnetkl.models.point_mlp import PointMLP, PooledMLP
from pointnetkl.registration import gicp, monte_carlo, pair
from pointnetkl.simulation import vehicle
from pointnetkl.slam.consistency.map_to_map import MapToMap
from pointnetkl.surveys.submap import Submap
from pointnetkl.workflow import parameters

PARAMS = Path(__file__).resolve().parents[1] / "params.yaml"


def main() -> None:
    """Compile all of them."""
    points = toy()
    register(points)
    MapToMap([points, points], 15.0, 1)(np.stack([np.eye(4), np.eye(4)]))
    sail()
    learn()


def toy() -> np.ndarray:
    """Return a hilly cloud (900, 3), metres."""
    x, y = np.meshgrid(np.arange(0.0, 90.0, 3.0), np.arange(0.0, 90.0, 3.0))
    return np.column_stack([x.ravel(), y.ravel(), (3 * np.sin(x / 15) * np.cos(y / 11)).ravel()])


def register(points: np.ndarray) -> None:
    """Register, label and describe a cloud."""
    settings = parameters.read(PARAMS, "registration", gicp.Settings)
    label = dataclasses.replace(parameters.read(PARAMS, "label", monte_carlo.Settings), held_out_runs=2, engine="cpu")
    monte_carlo.label(Submap("toy", 0, points, points[::2], points[1::2]), 20, label, settings)
    cloud = gicp.prepare(points, settings)
    gicp.register(cloud, cloud, settings)
    of_pair = pair.Settings(**dataclasses.asdict(settings), method="map")
    prior = np.diag(monte_carlo.prior_sigmas(label, settings.dimensions) ** 2)
    found = pair.register(gicp.Part(cloud.points, cloud.normals), cloud, prior, cloud.spacing_m, of_pair)
    pair.at(cloud, cloud, found.T_target_source, 8 * cloud.spacing_m, of_pair, in_plane=True)
    mean_field.describe(points, mean_field.conditions(label, settings))


def sail() -> None:
    """Simulate one short line of the demo's first survey."""
    settings = next(iter(parameters.read(PARAMS, "simulate", dict[str, simulation.Settings]).values()))
    layout = dataclasses.replace(settings.layout, lines=1, line_length_m=60.0)
    settings = dataclasses.replace(settings, layout=layout, grid=str(PARAMS.parent / settings.grid))
    platform = parameters.read(PARAMS, f"vehicles.{settings.vehicle}", vehicle.Settings)
    list(simulation.survey(settings, platform, simulation.ground(settings)))


def learn() -> None:
    """Take one training step of a PointNetKL's layers."""
    layers = [PointMLP((3, 4)), PooledMLP((4, 4))]
    rows = layers[0](torch.zeros(8, 3))
    layers[1](rows.reshape(2, 4, 4)).sum().backward()


if __name__ == "__main__":
    sys.exit(main())
