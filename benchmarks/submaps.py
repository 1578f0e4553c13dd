"""The ground that the benchmarks register on: simulated submaps of both test surveys, from flat to rugged."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pointnetkl import simulation
from pointnetkl.methods.fitted import structure_tensor
from pointnetkl.registration import gicp
from pointnetkl.simulation import seabed
from pointnetkl.workflow import parameters, study
from pointnetkl.workflow.errors import PointNetKLError

POINTS = 6534  # of a submap: those of the specification's measurements; the paper's mean is 6553
SURVEYS = ("borno_8", "thwaites_11")  # 3.2 and 6.7 m between points
TERRAINS = {"flat": 0.0, "typical": 0.5, "rugged": 1.0}  # rank among the drawn
DRAWN = 15  # of each survey


class BenchmarkError(PointNetKLError):
    """A benchmark cannot run as it was asked to."""


@dataclass(frozen=True)
class Ground:
    """A submap to register on."""

    survey: str
    spacing_m: float
    slope: float  # root mean square along the gentlest direction: what is left to hold on to there
    points: np.ndarray  # (n, 3) metres, centred


def ladder(params: Path, survey: str, drawn: int, points: int, seed: int, passes: int = 1) -> list[Ground]:
    """Return so many submaps drawn from a survey's terrain, flattest first, of so many points for each pass over it.

    Raises:
        SettingsError: the parameter file has no such survey.
        GicpError: a submap of so few points cannot be registered.
    """
    terrain = parameters.read(params, f"simulate.{survey}.terrain", seabed.Settings)
    registration = parameters.read(params, "registration", gicp.Settings)
    spacing_m = study.survey(params, survey).point_spacing_m
    size = passes * points, spacing_m / np.sqrt(passes)
    clouds = [simulation.patch(terrain, *size, np.random.default_rng([seed, k])) for k in range(drawn)]
    grounds = [Ground(survey, spacing_m, _gentlest_slope(cloud, registration), cloud) for cloud in clouds]
    return sorted(grounds, key=lambda ground: ground.slope)


def chosen(params: Path, terrain: str, points: int, seed: int, passes: int = 1) -> dict[str, Ground]:
    """Return the submaps of one terrain, or of "all", from each survey's ladder, by survey and terrain."""
    names = list(TERRAINS) if terrain == "all" else [terrain]
    ladders = {survey: ladder(params, survey, DRAWN, points, seed, passes) for survey in SURVEYS}
    return {
        f"{survey} {name}": grounds[round(TERRAINS[name] * (len(grounds) - 1))]
        for survey, grounds in ladders.items()
        for name in names
    }


def _gentlest_slope(cloud: np.ndarray, registration: gicp.Settings) -> float:
    normals = gicp.prepare(cloud, registration).normals.astype(np.float64)
    smallest = np.linalg.eigvalsh(structure_tensor.slope_tensor(normals))[0]
    return float(np.sqrt(max(smallest, 0.0) / len(cloud)))
