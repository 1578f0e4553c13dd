"""A small lawnmower over rugged ground, made in a moment: submaps, and their true poses."""

import numpy as np

from pointnetkl.registration import gicp
from pointnetkl.slam.closures import graph_construction, loop_closure
from pointnetkl.slam.graph.pose_graph import ClosureNoise, DeadReckoningNoise
from pointnetkl.slam.graph.survey_graph import SurveyGraph
from pointnetkl.surveys import pose
from pointnetkl.surveys.submap import Submap

LENGTH, SWATH, POINTS, SPACING = 30.0, 40.0, 500, 0.8
DEAD_RECKONING = DeadReckoningNoise(1e-4, 1e-4, 1e-2, 5.0, 5.0, 1.0)
CLOSURE = ClosureNoise(0.01, 0.01, 0.0316, 0.01)
SETTINGS = loop_closure.Settings(1, 2, 0.6, 1.0, 5.0, 2.0, DEAD_RECKONING, CLOSURE)
REGISTRATION = gicp.Settings(20, 1e-3, 20.0, 1e-3, 50)


def seabed(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return the height of a rugged seabed without a preferred direction, metres."""
    rng = np.random.default_rng(0)
    waves = zip(rng.uniform(0.2, 0.8, 30), rng.uniform(0, 6.3, 30), rng.uniform(0, 6.3, 30), strict=True)
    return sum(0.3 * np.cos(k * (np.cos(a) * x + np.sin(a) * y) + phase) for k, a, phase in waves)


def sail(lines: int, along: int, apart: float = 10.0) -> tuple[list[Submap], np.ndarray]:
    """Return the submaps of lines to and fro, `apart` metres, and their true poses (n, 4, 4)."""
    rng, submaps, truth = np.random.default_rng(1), [], []
    for line in range(lines):
        for step in range(along):
            x = LENGTH * (step + 0.5 if line % 2 == 0 else along - step - 0.5)
            T = pose.matrix(np.array([x, apart * line, -20.0]), np.pi * (line % 2))
            truth.append(T)
            submaps.append(_submap(len(submaps), T, rng))
    return submaps, np.array(truth)


def _submap(number: int, T_map_submap: np.ndarray, rng: np.random.Generator) -> Submap:
    points = rng.uniform(-0.5, 0.5, (POINTS, 3)) * [LENGTH, SWATH, 0.0]
    x, y, _ = pose.transform(T_map_submap, points).T
    points[:, 2] = seabed(x, y) - 40.0
    return Submap("toy", number, points, points[::2], points[1::2])


def graph(
    lines: int = 3,
    along: int = 4,
    has_truth: bool = True,
    apart: float = 10.0,
    registration: gicp.Settings = REGISTRATION,
) -> tuple[list[Submap], SurveyGraph]:
    """Return submaps and their graph, by navigation that drifts a little; without truth if it is not known."""
    submaps, truth = sail(lines, along, apart)
    navigation = truth.copy()
    navigation[1:, :2, 3] += 0.1 * np.cumsum(np.random.default_rng(2).normal(size=(len(truth) - 1, 2)), axis=0)
    q = np.diag([0.01, 0.01, 1e-5][: registration.dimensions])
    labels = {s.number: q for s in submaps}
    known_truth = truth if has_truth else np.full_like(truth, np.nan)
    survey_graph = graph_construction.build(
        "toy", submaps, navigation, known_truth, labels, SPACING, SETTINGS, registration
    )
    return submaps, survey_graph
