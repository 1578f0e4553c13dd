"""Do covariances describe the errors of real loop closures? The numbers, from what stage `calibrate` left."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from scipy import linalg, stats

from pointnetkl.registration.covariance import gaussian, table
from pointnetkl.registration.covariance.catalogue import PAIR, SPLIT
from pointnetkl.reporting import intervals
from pointnetkl.reporting.results import GOLD, Folders, Labels, Test
from pointnetkl.slam.closures.tables import BUILT, CLOSURES, DESCRIPTION, PLACED, TO_GT, YAW
from pointnetkl.workflow import artifacts

_OF_PLACED = ("nees", "nees_median", "coverage_95", "inflation")
_GOAL = 0.95  # of the errors, inside the ellipse that should hold so many
FIRM = "below 0.1 m"  # the class of submaps that the ground holds best
_HOLDS_M = {FIRM: (0.0, 0.1), "0.1 to 1 m": (0.1, 1.0), "above 1 m": (1.0, np.inf)}
_MOST_M2, _LEAST_M2, _HALVINGS = 1e4, 1e-8, 24  # of a search for the variance to add


@dataclass(frozen=True)
class Closures:
    """A test survey's registrations, and the covariances (M, M) that every method gives their submaps."""

    rows: pd.DataFrame  # schema CLOSURES, of every draw of the graph
    covariances: Mapping[str, Mapping[int, np.ndarray]]  # by method and submap

    @property
    def against(self) -> str:
        """Say what errors are told from: the truth, or GT where that is not known."""
        return "gt" if self.rows[f"{BUILT}_x_m"].isna().any() else "truth"

    def errors(self, kind: str = BUILT) -> np.ndarray:
        """Return the errors (r, M) of the registrations, in their submaps' frames.

        BUILT: of the loop closures, as the graph has them (against GT where the truth is not known). PLACED: of
        registrations from the same starts with every submap where it truly lies. TO_GT: of the first, against GT.
        """
        kind = TO_GT if kind == BUILT and self.against == "gt" else kind
        units = [unit for unit in ("x_m", "y_m", "w_rad") if f"{kind}_{unit}" in self.rows]
        return self.rows[[f"{kind}_{unit}" for unit in units]].to_numpy(np.float64)

    def judged(self, method: str, kind: str = BUILT) -> tuple[np.ndarray, np.ndarray]:
        """Return the errors (r, M) that there are, of submaps that a method has a covariance for, and those."""
        known, errors = self.covariances[method], self.errors(kind)
        there = self.rows["submap"].isin(list(known)).to_numpy() & np.isfinite(errors).all(axis=1)
        q = [known[number] for number in self.rows["submap"][there]]
        return errors[there], np.array(q).reshape(-1, *2 * [errors.shape[1]])


def read(folders: Folders, name: str, labels: Labels, test: Test) -> Closures:
    """Read a test survey's loop closures, and bring every method's covariances together."""
    rows = artifacts.read_table(folders.data / f"closures/{name}.parquet", CLOSURES, also=YAW)
    path = folders.data / f"closures/{name}_covariances.parquet"
    numbers = labels.submap.tolist()
    every = {GOLD: labels.q, **test.covariances}
    covariances = {method: dict(zip(numbers, q, strict=True)) for method, q in every.items()}
    for method, of in artifacts.read_table(path, table.SCHEMA, also=table.YAW).groupby("method", sort=False):
        covariances[str(method)] = dict(zip(of["submap"].tolist(), table.to_matrices(of), strict=True))
    return Closures(rows, covariances)


def calibrations(every: Mapping[str, Closures]) -> dict[str, dict[str, Any]]:
    """Return by survey and method how well the covariances describe the errors of all draws' registrations.

    nees and coverages are as gaussian.calibration returns them; nees_median, which heavy tails leave alone, is the
    median of e^T Q^-1 e over that of a chi-squared: 1 is right. `placed_*`: the same of registrations with every submap
    where it truly lies. inflation: the factor, added_m2: the variance added in x and y, with which Q's 95 % ellipses
    hold 95 %; and the coverage here with what was so found on the other test surveys.
    """
    return {name: dict(_by_method(name, every)) for name in every}


def ratios(of: Closures, method: str) -> pd.DataFrame:
    """Return a row per submap of draw 0: by how much its Q_ij is wider than a method's Q_i in x, y, and its terrain.

    `ratio` is of root mean squares, sqrt(tr Q_ij / tr Q_i); `worst_ratio` of standard deviations in the direction in
    which that is largest. Determinants tell nothing: a submap's error on its targets hardly depends on the start, so
    that Q_ij is almost of rank one.
    """
    mine, pair = of.covariances.get(method, {}), of.covariances.get(PAIR, {})
    rows = of.rows[(of.rows["draw"] == 0) & of.rows["submap"].isin(set(mine) & set(pair))]
    both = [(pair[number][:2, :2], mine[number][:2, :2]) for number in rows["submap"]]
    size = np.array([np.trace(q_ij) / np.trace(q_i) for q_ij, q_i in both])
    worst = np.array([linalg.eigh(q_ij, q_i, eigvals_only=True)[-1] for q_ij, q_i in both])
    return rows[["submap", *DESCRIPTION]].assign(ratio=np.sqrt(size), worst_ratio=np.sqrt(worst))


def sizes(of: Closures) -> dict[str, Any]:
    """Return what a survey's registrations are like, and how large their errors are."""
    rows = of.rows
    return {
        "against": of.against if len(rows) else None,
        "registrations": len(rows),
        "submaps": int(rows["submap"].nunique()),
        "converged": float(rows["converged"].mean()) if len(rows) else None,
        **{name: _median(rows[name].to_numpy()) for name in DESCRIPTION},
        **{f"{kind}_m": _rms(of.errors(kind)) for kind in (BUILT, TO_GT, PLACED)},
    }


def dependence(of: Closures) -> dict[str, dict[str, Any]]:
    """Return by method how Q_ij / Q_i depends on terrain: its median, and Spearman's correlations with it."""
    return {method: _dependence(ratios(of, method)) for method in (GOLD, SPLIT) if method in of.covariances}


def by_hold(of: Closures) -> dict[str, dict[str, Any]]:
    """Return, by how well Q_ij says that the ground holds a submap, how large the errors and their causes are, medians.

    The classes are of the root of Q_ij's trace in x, y.
    """
    pair = of.covariances.get(PAIR, {})
    sigma = of.rows["submap"].map({number: float(np.sqrt(np.trace(q[:2, :2]))) for number, q in pair.items()})
    found = {}
    for name, (low, high) in _HOLDS_M.items():
        which = ((sigma >= low) & (sigma < high)).to_numpy(bool)
        errors = {f"{kind}_m": np.hypot(*of.errors(kind)[which, :2].T) for kind in (BUILT, PLACED)}
        causes = {cause: of.rows[cause].to_numpy()[which] for cause in ("given_m", "heading_m")}
        if which.any():
            middles = {key: _median(values) for key, values in (errors | causes).items()}
            found[name] = {"registrations": int(which.sum()), **middles}
    return found


def _median(values: np.ndarray) -> float | None:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if len(known) else None


def _dependence(found: pd.DataFrame) -> dict[str, Any]:
    middles = {name: _median(found[name].to_numpy()) for name in ("ratio", "worst_ratio")}
    return {**middles, **{n: _rank_correlation(found[n], found["ratio"]) for n in DESCRIPTION[:3]}}


def _rank_correlation(a: pd.Series, b: pd.Series) -> float | None:
    if len(a) < intervals.FEWEST or a.nunique() < 2 or b.nunique() < 2:
        return None
    return float(stats.spearmanr(a, b).statistic)


def _by_method(name: str, every: Mapping[str, Closures]) -> Iterator[tuple[str, dict[str, Any]]]:
    for method in every[name].covariances:
        errors, q = every[name].judged(method)
        if len(errors):
            others = [of.judged(method) for other, of in every.items() if other != name and method in of.covariances]
            placed = _told(*every[name].judged(method, PLACED))
            yield (
                method,
                {
                    **_told(errors, q),
                    **{f"placed_{key}": placed.get(key) for key in _OF_PLACED},
                    **_widened(errors, q, [each for each in others if len(each[0])]),
                },
            )


def _told(errors: np.ndarray, q: np.ndarray) -> dict[str, float]:
    if not len(errors):
        return {}
    middle = float(np.median(_squared(errors, q)) / stats.chi2.ppf(0.5, errors.shape[1]))
    return {**gaussian.calibration(errors[:, None], q), "nees_median": middle, "inflation": _inflation(errors, q)}


def _widened(errors: np.ndarray, q: np.ndarray, others: Sequence[tuple[np.ndarray, np.ndarray]]) -> dict[str, Any]:
    found: dict[str, Any] = {"added_m2": _added(errors, q)}
    if others:
        elsewhere = [np.concatenate(each) for each in zip(*others, strict=True)]
        factor, variance = _inflation(*elsewhere), _added(*elsewhere)
        found["coverage_95_inflated"] = _inside(errors, factor * q)
        found["coverage_95_added"] = None if variance is None else _inside(errors, _wider(q, variance))
    return found


def _inflation(errors: np.ndarray, q: np.ndarray) -> float:
    return float(np.quantile(_squared(errors, q), _GOAL) / stats.chi2.ppf(_GOAL, errors.shape[1]))


def _added(errors: np.ndarray, q: np.ndarray) -> float | None:
    """Return the least variance, to 0.1 %, None where none is enough (yaw, to which nothing is added, is too sure)."""
    if _inside(errors, q) >= _GOAL:
        return 0.0
    if _inside(errors, _wider(q, _MOST_M2)) < _GOAL:
        return None
    low, high = np.log(_LEAST_M2), np.log(_MOST_M2)
    for _ in range(_HALVINGS):
        middle = (low + high) / 2
        low, high = (low, middle) if _inside(errors, _wider(q, np.exp(middle))) >= _GOAL else (middle, high)
    return float(np.exp(high))


def _wider(q: np.ndarray, variance: float) -> np.ndarray:
    return np.asarray(q + variance * np.diag([1.0, 1.0, 0.0][: q.shape[-1]]))


def _inside(errors: np.ndarray, q: np.ndarray) -> float:
    return float(np.mean(_squared(errors, q) <= stats.chi2.ppf(_GOAL, errors.shape[1])))


def _squared(errors: np.ndarray, q: np.ndarray) -> np.ndarray:
    return gaussian.squared_mahalanobis(errors[:, None], q)[:, 0]


def _rms(errors: np.ndarray) -> float | None:
    known = errors[np.isfinite(errors).all(axis=1), :2]
    return float(np.sqrt((known**2).sum(axis=1).mean())) if len(known) else None
