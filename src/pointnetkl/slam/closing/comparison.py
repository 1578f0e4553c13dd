"""Table V: a survey closed from its own navigation, with each method's covariance of the loop closures.

The paper corrupts the yaw, and gives dead reckoning 5 m an edge. Here nothing is corrupted: poses are navigation's, as
sure as the vehicle's drift leaves them. `map` registers by MAP. All others weight one set of GICP's ends, so that they
differ by their covariance alone: `pair` by that of the matches, the rest by that of the source. Gates are the same.

One survey has one drift. Where the truth is known, others are drawn about it from the same rates.
"""

import functools
import zlib
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pandas as pd
from scipy import stats

from pointnetkl.registration import pair
from pointnetkl.registration.covariance import catalogue
from pointnetkl.slam.closing import drift, survey
from pointnetkl.slam.closing.estimate import Estimate, Tie, from_matrices, to_matrices
from pointnetkl.slam.closing.schemas import CLOSURES, POSES, ROWS, State
from pointnetkl.slam.closing.survey import Closed
from pointnetkl.slam.graph import trajectory_error
from pointnetkl.workflow import compute
from pointnetkl.workflow.parameters import require_seed

RIVALS = (catalogue.MONTE_CARLO, catalogue.CONSTANT, catalogue.NETWORK, catalogue.SPLIT)
Covariances = Mapping[str, np.ndarray]  # Q (n, 2, 2) by method, m^2, in the submaps' frames


@dataclass(frozen=True)
class Settings:
    """Section `close` of the parameters.

    Raises:
        ValueError: a setting is out of its range.
    """

    seed: int  # of drawn drifts
    drifts: int  # that are drawn about the truth, besides the recorded one
    believed: list[float]  # factors of the drift's sigmas that closing is told; the first is what others than map get
    closing: survey.Settings = field(default_factory=survey.Settings)

    def __post_init__(self) -> None:
        """Refuse numbers out of their range."""
        require_seed(self.seed)
        if self.drifts < 0:
            raise ValueError(f"drifts is {self.drifts}, must be 0 or above")
        once = len(set(self.believed)) == len(self.believed)
        if not self.believed or not once or not all(factor > 0 for factor in self.believed):
            raise ValueError(f"believed is {self.believed}, must be factors above zero, one at least, each once")


@dataclass(frozen=True)
class Track:
    """A survey's submaps, where navigation has them, and where they truly lie."""

    survey: str
    number: np.ndarray  # (n,) of the submaps
    clouds: Sequence[np.ndarray]  # n of (n_i, 3), metres, in the submaps' frames
    navigation: np.ndarray  # (n, 4, 4) T_map_submap
    truth: np.ndarray  # (n, 4, 4); NaN where it is not known
    time_s: np.ndarray  # (n,)
    fix: drift.Fix  # where navigation was last right
    drift: drift.Settings
    spacing_m: float  # of the points

    @property
    def has_truth(self) -> bool:
        """Return whether the truth is known."""
        return bool(np.isfinite(self.truth).all())

    def covariance(self, believed: float) -> np.ndarray:
        """Return the covariance (3 n, 3 n) of the poses, with sigmas of drift times a factor."""
        return drift.covariance(self.time_s, self.navigation[:, :2, 3], self.drift.times(believed), self.fix)


@dataclass(frozen=True)
class Results:
    """The content of the stage's outputs."""

    rows: pd.DataFrame
    poses: pd.DataFrame
    closures: pd.DataFrame


def compare(track: Track, rivals: Covariances, settings: Settings, registration: pair.Settings) -> Results:
    """Return the errors of every method in every run, and what method map made of the recorded navigation.

    Raises:
        ClosingError, DriftError: the survey cannot be closed.
    """
    runs = range(1 + settings.drifts if track.has_truth else 1)
    one = functools.partial(_run, track, rivals, settings, registration)
    outcomes = compute.over(one, runs, f"close {track.survey}", unit="drift")
    rows = pd.DataFrame([row for part in outcomes for row in part[0]], columns=ROWS.names)
    recorded = outcomes[0][1]
    return Results(rows, _poses(track, recorded), closures(track, recorded))


def none() -> Results:
    """Return the results for a survey without a track: tables without rows."""
    return Results(*(schema.empty_table().to_pandas() for schema in (ROWS, POSES, CLOSURES)))


def drawn(track: Track, run: int, seed: int) -> Track:
    """Return the track with another drift about the truth; run 0 is the recorded one."""
    if not run:
        return track
    offset = (track.truth - track.navigation)[0, :2, 3]  # of frames or antennas: no drift
    fix = replace(track.fix, x_m=track.fix.x_m + offset[0], y_m=track.fix.y_m + offset[1])
    sailed = replace(track, navigation=track.truth, fix=fix)
    rng = np.random.default_rng([seed, zlib.crc32(track.survey.encode()), run])
    L = np.linalg.cholesky(sailed.covariance(1.0))  # and no eigenvectors, whose signs hang on the last digit
    plane = from_matrices(track.truth) + (L @ rng.normal(size=len(L))).reshape(-1, 3)
    return replace(sailed, navigation=to_matrices(plane, track.navigation))


def _run(
    track: Track, rivals: Covariances, settings: Settings, registration: pair.Settings, run: int
) -> tuple[list[dict[str, Any]], Closed]:
    sailed = drawn(track, run, settings.seed)
    believed, *others = settings.believed
    by_map = _close(sailed, believed, settings, replace(registration, method="map"))
    by_pair = _close(sailed, believed, settings, replace(registration, method="gicp"))
    closed = {
        **{method: survey.with_covariances(by_pair, Q, settings.closing) for method, Q in rivals.items()},
        catalogue.PAIR: by_pair,
        catalogue.MAP: by_map,
    }
    ties = [f.closure.tie for f in by_map.found if f.closure is not None]
    key = {"survey": sailed.survey, "method": catalogue.NAVIGATION, "run": run, "believed": believed}
    rows = [key | errors(sailed.navigation, by_map.navigation, sailed.truth, ties)]
    rows += [_row(sailed, method, run, believed, outcome, ties) for method, outcome in closed.items()]
    for factor in others:
        outcome = _close(sailed, factor, settings, replace(registration, method="map"))
        rows.append(_row(sailed, catalogue.MAP, run, factor, outcome, ties))
    return rows, by_map


def _close(sailed: Track, believed: float, settings: Settings, registration: pair.Settings) -> Closed:
    covariance = sailed.covariance(believed)
    return survey.close(sailed.clouds, sailed.navigation, covariance, sailed.spacing_m, settings.closing, registration)


def _row(sailed: Track, method: str, run: int, believed: float, closed: Closed, ties: Sequence[Tie]) -> dict[str, Any]:
    states = Counter(f.state for f in closed.found)
    counts = {"closures": len(closed.found), "accepted": states[State.ACCEPTED], "flat": states[State.FLAT]}
    key = {"survey": sailed.survey, "method": method, "run": run, "believed": believed}
    known = errors(closed.poses, closed.estimate, sailed.truth, ties)
    return key | known | {"variance_factor": closed.variance_factor} | counts


def errors(poses: np.ndarray, estimate: Estimate, truth: np.ndarray, ties: Sequence[Tie]) -> dict[str, float]:
    """Return the errors of poses (n, 4, 4) against the truth: schemas.ERRORS, pose_nees and joined_95.

    They are NaN where the truth is not known. `estimate` has the covariance of the poses; `ties` are of the pairs that
    joined_m is of.
    """
    e = (poses - truth)[:, :2, 3]
    aligned = trajectory_error.align_se2(poses[:, :3, 3], truth[:, :3, 3])
    plane, true = from_matrices(poses), from_matrices(truth)
    apart = np.array([tie.offset(plane) - tie.offset(true) for tie in ties]).reshape(-1, 2)
    variances = estimate.marginals[:, :2, :2]
    relative = np.array([tie.variance(estimate) for tie in ties]).reshape(-1, 2, 2)
    within = _squares(apart, relative) <= stats.chi2.ppf(0.95, 2)
    return {
        "as_it_is_m": trajectory_error.rmse(poses[:, :2, 3], truth[:, :2, 3]),
        "se2_m": trajectory_error.rmse(aligned[:, :2], truth[:, :2, 3]),
        "joined_m": float(np.sqrt(np.mean(np.sum(apart**2, axis=1)))) if ties else float("nan"),
        "pose_nees": float(np.mean(_squares(e, variances)) / 2),
        "joined_95": float(within.mean()) if ties and np.isfinite(apart).all() else float("nan"),
    }


def _squares(e: np.ndarray, variances: np.ndarray) -> np.ndarray:
    # e^T V^-1 e (n,) of errors (n, 2)
    return np.einsum("ni,ni->n", e, np.linalg.solve(variances, e[:, :, None])[:, :, 0])


def _poses(track: Track, closed: Closed) -> pd.DataFrame:
    plane = closed.estimate.poses
    sigmas = np.sqrt(np.diagonal(closed.estimate.marginals, axis1=1, axis2=2))
    columns = {"x_m": plane[:, 0], "y_m": plane[:, 1], "z_m": closed.poses[:, 2, 3], "yaw_rad": plane[:, 2]}
    columns |= {f"sigma_{name}": sigmas[:, i] for i, name in enumerate(("x_m", "y_m", "yaw_rad"))}
    key = {"survey": track.survey, "submap": track.number, "time_s": track.time_s}
    return pd.DataFrame({**key, **columns})[POSES.names]


def closures(track: Track, closed: Closed) -> pd.DataFrame:
    """Return what became of a survey's closures (schemas.CLOSURES)."""
    rows = []
    for f in closed.found:
        of_all: dict[str, Any] = {
            "survey": track.survey,
            "source": track.number[f.source],
            "state": str(f.state),
            "rank": 0,
        }
        c = f.closure
        if c is not None:
            of_all |= {
                "rank": c.rank,
                "residual_m": np.sqrt(c.residual_variance),
                "moved_m": np.hypot(*c.end),
                "sigmas": np.linalg.norm(c.residual(closed.estimate.poses)),
            }
        shares = [np.nan] * len(f.targets) if c is None else c.tie.shares.tolist()
        rows += [
            of_all | {"target": track.number[k], "share": share} for k, share in zip(f.targets, shares, strict=True)
        ]
    return pd.DataFrame(rows, columns=CLOSURES.names)
