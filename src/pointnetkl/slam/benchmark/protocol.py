"""The SLAM benchmark's graphs: the noise that corrupts them, and each method's covariances on their edges (Table IV).

The paper's table has one graph and many draws of the noise. We add a few draws of the noise on each of several draws of
the loop closures, and two variants of the table: the other way to count edges, and the authors' slips. Module
`benchmark` runs it.
"""

import zlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pandas as pd

from pointnetkl.registration.covariance import catalogue, gaussian, table
from pointnetkl.slam.benchmark import authors_slips
from pointnetkl.slam.benchmark.schemas import AUTHORS, TABLE
from pointnetkl.slam.graph import pose_graph, survey_graph
from pointnetkl.slam.graph.pose_graph import PoseGraph
from pointnetkl.slam.graph.survey_graph import SurveyGraph
from pointnetkl.surveys import pose
from pointnetkl.workflow.errors import PointNetKLError
from pointnetkl.workflow.parameters import require_positive, require_seed, require_within

# methods of the variants: the paper's, and our best
FEW = (catalogue.MONTE_CARLO, catalogue.CONSTANT, catalogue.NAIVE_GICP, catalogue.POINTNETKL, catalogue.NETWORK)
Methods = Mapping[str, Mapping[int, np.ndarray]]  # Q (M, M) by method and submap


class SlamError(PointNetKLError):
    """The benchmark cannot run on these covariances."""


@dataclass(frozen=True)
class Settings:
    """Section `slam` of the parameters.

    Raises:
        ValueError: a setting is out of its range.
    """

    seed: int  # of the yaw noise
    repetitions: int  # noise draws on the first draw of the loop closures
    draw_repetitions: int  # and on each of the others
    yaw_sigma_rad: float  # of each edge of dead reckoning
    edges: str  # all: a registration counts once for each of its edges; shared: it counts once
    floor_m2: float  # added to the variances of every Q
    map_to_map_repetitions: int  # repetitions whose map is measured, from the first
    map_cell_m: float
    map_thinning: int  # every so many-th point asks

    def __post_init__(self) -> None:
        """Refuse numbers out of their range, and unknown ways to count edges."""
        require_seed(self.seed)
        require_positive(self, "repetitions", "draw_repetitions", "map_thinning")
        require_within(self, 0.1, 1e4, "map_cell_m")
        require_within(self, 0.0, 1e4, "floor_m2")
        if self.draw_repetitions > self.repetitions:
            raise ValueError(f"draw_repetitions is {self.draw_repetitions}, must be at most repetitions")
        if self.edges not in ("all", "shared"):
            raise ValueError(f"edges is {self.edges!r}, must be all or shared")
        for name in ("yaw_sigma_rad", "map_to_map_repetitions"):
            if getattr(self, name) < 0:
                raise ValueError(f"{name} is {getattr(self, name)}, must not be negative")


class Variant(NamedTuple):
    """One way to run the benchmark, and its methods."""

    name: str
    edges: str  # all or shared
    methods: Sequence[str]

    def repetitions(self, draw: int, settings: Settings) -> int:
        """Return the number of noise draws on a draw of the loop closures."""
        return settings.repetitions if draw == 0 and self.name in (TABLE, AUTHORS) else settings.draw_repetitions


def variants(methods: Iterable[str], settings: Settings) -> list[Variant]:
    """Return the table, with all methods, and its variants, with a few of them."""
    names = list(methods)
    few = [name for name in FEW if name in names]
    other = "shared" if settings.edges == "all" else "all"
    return [Variant(TABLE, settings.edges, names), Variant(other, other, few), Variant(AUTHORS, settings.edges, few)]


def corrupt(graph: SurveyGraph, draw: int, repetition: int, settings: Settings) -> np.ndarray:
    """Return dead reckoning (n - 1, 4, 4) with noise on each edge's yaw, which does not depend on the method."""
    seed = [settings.seed, zlib.crc32(graph.survey.encode()), draw, repetition]
    return with_noise(graph, np.random.default_rng(seed), settings.yaw_sigma_rad)


def with_noise(graph: SurveyGraph, rng: np.random.Generator, yaw_sigma_rad: float) -> np.ndarray:
    """Return dead reckoning (n - 1, 4, 4) with Gaussian noise on each edge's yaw."""
    exact = pose_graph.between(graph.gt)
    rotations = [pose.matrix(np.zeros(3), yaw) for yaw in rng.normal(0.0, yaw_sigma_rad, len(exact))]
    return exact @ np.array(rotations).reshape(-1, 4, 4)


def by_method(covariances: pd.DataFrame, floor: float = 0.0) -> dict[str, dict[int, np.ndarray]]:
    """Return Q (M, M) by method and submap of a covariance table, methods in the table's order.

    `floor`, m^2, is added to each (gaussian.with_floor).

    Raises:
        CovarianceError: a Q is not a covariance.
        SlamError: a method has two covariances for one submap.
    """
    twice = covariances.duplicated(["method", "submap"])
    if twice.any():
        row = covariances[twice].iloc[0]
        raise SlamError(f"{row['method']} has two covariances for submap {row['submap']}; rename one of the methods")
    covariances_by_method: dict[str, dict[int, np.ndarray]] = {}
    rows = covariances[["method", "submap"]].itertuples(index=False)
    for (method, number), q in zip(rows, table.to_matrices(covariances), strict=True):
        checked = gaussian.check(q, f"submap {number}, {method}")
        covariances_by_method.setdefault(method, {})[int(number)] = gaussian.with_floor(checked, floor)
    return covariances_by_method


def pose_graphs(graph: SurveyGraph, methods: Methods, variant: Variant, draw: int = 0) -> dict[str, PoseGraph]:
    """Return by method the factors that all repetitions share: the held first node and a draw's loop closures."""
    closures, noise = graph.draws[draw], graph.closure_noise
    graphs = {}
    for name in variant.methods:
        edges, origin = closures.edges, f"{graph.survey}, {name}"
        full = survey_graph.full_covariances(graph.number, methods[name], closures, noise, origin, variant.edges)
        if variant.name == AUTHORS:
            edges, full = authors_slips.closures(edges, full)
        graphs[name] = PoseGraph(graph.gt[0], edges, full)
    return graphs


def node_clouds(graph: SurveyGraph, clouds: Mapping[int, np.ndarray]) -> Sequence[np.ndarray]:
    """Return the nodes' clouds in the nodes' order, of clouds by submap number.

    Raises:
        SlamError: a node's submap has no cloud.
    """
    if missing := [int(number) for number in graph.number if int(number) not in clouds]:
        raise SlamError(f"{graph.survey}: submap {missing[0]} of the graph has no points; run dvc repro")
    return [clouds[int(number)] for number in graph.number]
