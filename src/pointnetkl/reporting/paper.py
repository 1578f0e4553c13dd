"""The numbers that the paper prints (Torroba, Sprague, Bore and Folkesson, RA-L 2020, Tables I to IV), beside ours.

Keys are the names of surveys and methods in `params.yaml` and in the covariance tables.
"""

from dataclasses import dataclass


@dataclass(frozen=True)
class Dataset:
    """A row of Table I; sigma_z is of points on the unit sphere."""

    vehicle: str
    area_km2: float
    submaps: int
    sigma_z: float


@dataclass(frozen=True)
class Slam:
    """A survey of Table IV: the graph's size, and errors in metres by method."""

    track_km: float
    dead_reckoning_edges: int
    loop_closures: int
    rmse_xyz_m: dict[str, float]
    map_to_map_m: dict[str, float]


# Table I
DATASETS = {
    "baltic": Dataset("surveyor", 504.8, 7543, 0.067827),
    "shetland": Dataset("surveyor", 21.3, 301, 0.066160),
    "borno_1": Dataset("hugin", 74.6, 940, 0.189505),
    "antarctica_7": Dataset("hugin", 88.5, 296, 0.246802),
}

# Table II: mean KL divergence of PointNetKL, nats
KL = {"training": 0.0184, "validation": 0.0394, "borno_8": 1.0578, "thwaites_11": 1.9899}

# Table III: seconds per submap, mean and standard deviation over 107 submaps of 6552.75 +- 766 points
RUNTIME = {"monte_carlo": (14.71, 5.08), "pointnetkl": (0.13, 0.02)}
RUNTIME_MACHINE = "Intel Core i7-7700HQ, 15.6 GiB"

# Table IV: its columns, in its order, then its rows
SLAM_METHODS = ("navigation", "corrupted", "monte_carlo", "constant", "naive_gicp", "pointnetkl")


def _row(*errors: float) -> dict[str, float]:
    return dict(zip(SLAM_METHODS, errors, strict=True))


SLAM = {
    "borno_8": Slam(
        47.8, 395, 301, _row(9.4, 210.8, 98.8, 114.1, 76.7, 67.3), _row(4.00, 6.25, 4.08, 4.05, 4.11, 4.06)
    ),
    "thwaites_11": Slam(
        51.9,
        222,
        176,
        _row(15.3, 323.4, 248.1, 287.1, 302.8, 259.5),
        _row(32.43, 34.17, 33.75, 34.04, 33.75, 33.65),
    ),
}

# Eigenvalues (m^2) of the covariances that the authors' network predicts on its test surveys, at these quantiles:
# not in the paper, from its public results; a loose guide to what its labels looked like, for its predictions
# are 1.06 and 1.99 nats off.
QUANTILES = (0.05, 0.25, 0.50, 0.75, 0.95)
EIGENVALUES = {
    "borno_8": {"smaller": (0.39, 5.87, 7.35, 7.69, 8.04), "larger": (4.75, 8.17, 8.49, 8.76, 9.19)},
    "thwaites_11": {"smaller": (0.37, 0.79, 1.08, 1.48, 2.56), "larger": (7.04, 8.32, 8.90, 9.35, 11.05)},
}

# How a reader calls what the tables call in snake case
_NAMES = {
    "borno_1": "Bornö 1",
    "borno_8": "Bornö 8",
    "constant": "Constant Q",
    "corrupted": "Corrupted",
    "gt": "GT",
    "monte_carlo": "Monte Carlo",
    "naive_gicp": "Naïve GICP",
    "navigation": "Navigation",
    "pointnetkl": "PointNetKL",
    "scituate": "Scituate",
}


def title(name: str) -> str:
    """Return a survey's or method's name as a reader calls it; other names stay as they are."""
    if name in _NAMES:
        return _NAMES[name]
    return name.replace("_", " ").capitalize() if name in DATASETS or name in SLAM else name
