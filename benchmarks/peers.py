"""Other libraries' GICP, called as one who wants a Monte Carlo label has to: a pair at a time."""

import time
from dataclasses import dataclass
from types import ModuleType

import numpy as np

from pointnetkl.registration import gicp
from submaps import BenchmarkError

ROTATION_TOLERANCE_RAD = 0.1 * np.pi / 180  # small_gicp's own


@dataclass(frozen=True)
class Registered:
    """What became of one registration."""

    translation: np.ndarray  # (2,) metres
    iterations: int
    converged: bool
    seconds: float
    preparing_s: float  # of these, for the source's covariances


class SmallGicp:
    """small_gicp on one thread: its GICP, k-d trees, downsampling off; all six degrees of freedom."""

    def __init__(self, target: np.ndarray, settings: gicp.Settings):
        """Prepare the target (n, 3).

        Raises:
            BenchmarkError: small_gicp is not installed.
        """
        self._library, self._settings = _library("small_gicp"), settings
        begun = time.perf_counter()
        self._target = self._library.PointCloud(target)
        self._tree = self._library.KdTree(self._target, num_threads=1)
        self._estimate(self._target, self._tree)
        self.prepare_s = time.perf_counter() - begun

    def register(self, source: np.ndarray) -> Registered:
        """Register a source (n, 3) from where it is: covariances of its own, then the alignment."""
        begun = time.perf_counter()
        cloud = self._library.PointCloud(source)
        built = time.perf_counter()
        self._estimate(cloud, self._library.KdTree(cloud, num_threads=1))
        prepared = time.perf_counter()
        found = self._library.align(
            self._target,
            cloud,
            self._tree,
            registration_type="GICP",
            max_correspondence_distance=self._settings.max_distance_m,
            num_threads=1,
            max_iterations=self._settings.max_iterations,
            rotation_epsilon=ROTATION_TOLERANCE_RAD,
            translation_epsilon=self._settings.tolerance_m,
        )
        seconds = time.perf_counter() - begun
        translation = found.T_target_source[:2, 3]
        return Registered(translation, found.iterations, found.converged, seconds, prepared - built)

    def _estimate(self, cloud: object, tree: object) -> None:
        self._library.estimate_covariances(cloud, tree, num_neighbors=self._settings.neighbours, num_threads=1)


class Open3d:
    """Open3D's GICP on as many cores as it takes; all six degrees of freedom, and no count of iterations."""

    def __init__(self, target: np.ndarray, settings: gicp.Settings):
        """Prepare the target (n, 3).

        Raises:
            BenchmarkError: Open3D is not installed.
        """
        self._library, self._settings = _library("open3d"), settings
        begun = time.perf_counter()
        self._target = self._cloud(target)
        self.prepare_s = time.perf_counter() - begun

    def register(self, source: np.ndarray) -> Registered:
        """Register a source (n, 3) from where it is: normals of its own, then the alignment."""
        methods, settings = self._library.pipelines.registration, self._settings
        begun = time.perf_counter()
        cloud = self._cloud(source)
        prepared = time.perf_counter()
        found = methods.registration_generalized_icp(
            cloud,
            self._target,
            settings.max_distance_m,
            np.eye(4),
            methods.TransformationEstimationForGeneralizedICP(settings.plane_epsilon),
            methods.ICPConvergenceCriteria(max_iteration=settings.max_iterations),
        )
        seconds = time.perf_counter() - begun
        return Registered(found.transformation[:2, 3], 0, True, seconds, prepared - begun)

    def _cloud(self, points: np.ndarray) -> object:
        cloud = self._library.geometry.PointCloud(self._library.utility.Vector3dVector(points))
        # Open3D takes covariances from normals; were there none, it would estimate them from 30 neighbours
        cloud.estimate_normals(self._library.geometry.KDTreeSearchParamKNN(self._settings.neighbours))
        return cloud


def _library(name: str) -> ModuleType:
    try:
        return __import__(name)
    except ImportError as error:
        raise BenchmarkError(f"{name} cannot be loaded ({error}); make setup brings it and what it needs") from error
