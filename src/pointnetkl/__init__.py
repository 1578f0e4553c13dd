"""PointNetKL: covariances of GICP registration for bathymetric SLAM, and the benchmark that judges them.

For use on board: `CovarianceEstimator.load(path).predict(points)`.
"""

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pointnetkl.estimator import CovarianceEstimator as CovarianceEstimator
    from pointnetkl.estimator import Prediction as Prediction

__version__ = "0.9.0"
__all__ = ["CovarianceEstimator", "Prediction"]


def __getattr__(name: str) -> Any:
    """Import the estimator when it is asked for: with it come torch and numba, which take seconds."""
    if name in __all__:
        return getattr(importlib.import_module("pointnetkl.estimator"), name)
    raise AttributeError(f"module 'pointnetkl' has no attribute {name!r}")
