"""Numbers on loop closures: do the methods' covariances describe their errors? From the tables of stage calibrate."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pandas as pd
from scipy import linalg, stats

from pointnetkl.registration.covariance import gaussian, table
from pointnetkl.registration.covariance.catalogue import GT, MEASURED_PAIR, SPLIT, SPLIT_RECALIBRATED, TRUTH
from pointnetkl.reporting import intervals
from pointnetkl.reporting.results import GOLD, Folders, Labels, ResultsError, Test
from pointnetkl.slam.closures.schemas import BUILT, CLOSURES, DESCRIPTION, ENDS, ENDS_YAW, PLACED, TO_GT, YAW
from pointnetkl.workflow import artifacts

FIRM = "below 0.1 m"  # the class of submaps that the ground holds best
_SIGMAS_M = {FIRM: (0.0, 0.1), "0.1 to 1 m": (0.1, 1.0), "above 1 m": (1.0, np.inf)}
_PLACED_MEASURES = ("nees", "nees_median", "coverage_95", "inflation", "birge")
_UNITS = ("x_m", "y_m", "w_rad")
_GOAL = 0.95  # share of the errors that the 95 % ellipses should hold
_MOST_M2, _LEAST_M2, _HALVINGS = 1e4, 1e-8, 24  # bounds and steps of the search for the variance to add

Errors = tuple[np.ndarray, np.ndarray]  # errors (r, M), and the covariance (r, M, M) of each


@dataclass(frozen=True)
class Closures:
    """A test survey's registrations, and covariances (M, M) of them: one a submap by most methods, by some one each."""

    rows: pd.DataFrame  # schema CLOSURES, of every draw of the graph
    covariances: Mapping[str, Mapping[int, np.ndarray]]  # by method and submap
    ends: Mapping[str, pd.DataFrame] = field(default_factory=dict)  # schema ENDS, by method of single registrations

    @property
    def methods(self) -> list[str]:
        """Return the methods of both kinds."""
        return [*self.covariances, *self.ends]

    @property
    def reference(self) -> str:
        """Return what the errors are measured against: the truth, or GT where the truth is not known."""
        return GT if self.rows[f"{BUILT}_x_m"].isna().any() else TRUTH

    def errors(self, kind: str = BUILT) -> np.ndarray:
        """Return the errors (r, M) of the registrations, in their submaps' frames.

        BUILT: the loop closures' errors as the graph has them (against GT where the truth is not known). TO_GT: the
        same against GT. PLACED: errors of registrations from the same starts, with every submap at its true pose.
        """
        kind = TO_GT if kind == BUILT and self.reference == GT else kind
        return _errors(self.rows, kind)

    def described(self, method: str, kind: str = BUILT) -> Errors:
        """Return the known errors that a method has covariances of, and these covariances.

        A method of single registrations has them of PLACED errors alone.
        """
        errors, q, _ = self._judged(method, kind)
        return errors, q

    def nodes(self, method: str) -> np.ndarray:
        """Return the submap (r,) of each PLACED error that `described` returns: those of one are not independent."""
        return self._judged(method, PLACED)[2]

    def _judged(self, method: str, kind: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        if method in self.ends:
            rows = self.ends[method] if kind == PLACED else self.ends[method].iloc[:0]
            return _errors(rows, PLACED), table.to_matrices(rows), rows["submap"].to_numpy()
        covariances, errors = self.covariances[method], self.errors(kind)
        known = self.rows["submap"].isin(list(covariances)).to_numpy() & np.isfinite(errors).all(axis=1)
        submaps = self.rows["submap"].to_numpy()[known]
        q = [covariances[number] for number in submaps.tolist()]
        return errors[known], np.array(q).reshape(-1, *2 * [errors.shape[1]]), submaps


def read(folders: Folders, survey: str, labels: Labels, test: Test) -> Closures:
    """Read a test survey's loop closures, and bring all methods' covariances together.

    Raises:
        ArtifactError: a table is missing or damaged.
        ResultsError: single registrations have covariances, and are not among the loop closures.
    """
    rows = artifacts.read_table(folders.product(survey, "closures.parquet"), CLOSURES, also=YAW)
    path = folders.product(survey, "closure_covariances.parquet")
    submaps = labels.submap.tolist()
    by_method = {GOLD: labels.q, **test.covariances}
    covariances = {method: dict(zip(submaps, q, strict=True)) for method, q in by_method.items()}
    measured = artifacts.read_table(path, table.SCHEMA, also=table.YAW)
    for method, own in measured.groupby("method", sort=False):
        covariances[str(method)] = dict(zip(own["submap"].tolist(), table.to_matrices(own), strict=True))
    path = folders.product(survey, "closure_ends.parquet")
    ends = artifacts.read_table(path, ENDS, also=ENDS_YAW)
    registered = pd.MultiIndex.from_frame(rows[["survey", "draw", "submap"]])
    if not pd.MultiIndex.from_frame(ends[["survey", "draw", "submap"]]).isin(registered).all():
        raise ResultsError(f"{path}: has registrations that closures.parquet lacks; run dvc repro calibrate@{survey}")
    return Closures(rows, covariances, {str(method): own for method, own in ends.groupby("method", sort=False)})


def calibrations(surveys: Mapping[str, Closures]) -> dict[str, dict[str, Any]]:
    """Return, by survey and method, how well the covariances describe the registrations' errors of all draws.

    nees and the coverages are as `gaussian.calibration` returns them. nees_median is the median of e^T Q^-1 e over that
    of a chi-squared variable, so that heavy tails do not move it; 1 is right. placed_* are the same measures of
    registrations with every submap at its true pose. inflation is the factor on Q, and added_m2 the variance added in x
    and y, with which the 95 % ellipses hold 95 % of the errors. coverage_95_inflated and coverage_95_added are this
    survey's coverage with the factor and the variance that the other test surveys need. birge is the root of nees, by
    which sigmas would be multiplied (Birge, Phys. Rev. 40, 1932).

    placed_log_likelihood is the mean of log N(e; 0, Q), nats, with its 95 % interval by submap, and placed_median_m the
    median size of these errors in x and y: MAP has errors of its own. Methods of single registrations have placed_*
    alone. split_recalibrated is split with the factor that is most likely on the other test surveys.
    """
    recalibrated = {survey: with_recalibrated(survey, surveys) for survey in surveys}
    return {survey: dict(_by_method(survey, recalibrated)) for survey in surveys}


def with_recalibrated(survey: str, surveys: Mapping[str, Closures]) -> Closures:
    """Return a survey's closures with SPLIT_RECALIBRATED: SPLIT times one factor for all ground, in M dimensions.

    No training survey closes a loop here, so the factor is that of the other test surveys whose truth is known: e^T
    Q^-1 e / M, the mean over their placed errors e, which makes these most likely. Without such a survey there is none.
    """
    closures = surveys[survey]
    others = [
        other.described(SPLIT, PLACED)
        for name, other in surveys.items()
        if name != survey and SPLIT in other.covariances and len(other.rows) and other.reference == TRUTH
    ]
    if SPLIT not in closures.covariances or not sum(len(errors) for errors, _ in others):
        return closures
    errors, q = (np.concatenate(parts) for parts in zip(*others, strict=True))
    factor = float(_squared(errors, q).mean()) / errors.shape[1]
    own = {number: factor * q for number, q in closures.covariances[SPLIT].items()}
    return replace(closures, covariances={**closures.covariances, SPLIT_RECALIBRATED: own})


def ratios(closures: Closures, method: str) -> pd.DataFrame:
    """Return by how much Q_ij is wider than a method's Q_i in x and y, with the terrain: a row per submap of draw 0.

    `ratio` compares root mean squares, sqrt(tr Q_ij / tr Q_i); `worst_ratio` compares standard deviations in the
    direction where Q_i falls shortest. Determinants would mislead: a submap's error on its targets hardly depends on
    the start, so Q_ij is almost of rank one.
    """
    single, pair = closures.covariances.get(method, {}), closures.covariances.get(MEASURED_PAIR, {})
    rows = closures.rows[(closures.rows["draw"] == 0) & closures.rows["submap"].isin(set(single) & set(pair))]
    both = [(pair[number][:2, :2], single[number][:2, :2]) for number in rows["submap"]]
    size = np.array([np.trace(q_ij) / np.trace(q_i) for q_ij, q_i in both])
    worst = np.array([linalg.eigh(q_ij, q_i, eigvals_only=True)[-1] for q_ij, q_i in both])
    return rows[["submap", *DESCRIPTION]].assign(ratio=np.sqrt(size), worst_ratio=np.sqrt(worst))


def sizes(closures: Closures) -> dict[str, Any]:
    """Return the number of a survey's registrations, medians of their description, and their errors' size."""
    rows = closures.rows
    return {
        "against": closures.reference if len(rows) else None,
        "registrations": len(rows),
        "submaps": int(rows["submap"].nunique()),
        "converged": float(rows["converged"].mean()) if len(rows) else None,
        **{name: _median(rows[name].to_numpy()) for name in DESCRIPTION},
        **{f"{kind}_m": _rms(closures.errors(kind)) for kind in (BUILT, TO_GT, PLACED)},
    }


def dependence(closures: Closures) -> dict[str, dict[str, Any]]:
    """Return by method the medians of `ratios`, and Spearman's correlations of `ratio` with the terrain."""
    return {method: _dependence(ratios(closures, method)) for method in (GOLD, SPLIT) if method in closures.covariances}


def by_hold(closures: Closures) -> dict[str, dict[str, Any]]:
    """Return medians of the errors and of their causes, by how well the ground holds a submap.

    The classes are of the root of Q_ij's trace in x and y.
    """
    pair = closures.covariances.get(MEASURED_PAIR, {})
    sigma = closures.rows["submap"].map({number: float(np.sqrt(np.trace(q[:2, :2]))) for number, q in pair.items()})
    classes = {name: ((sigma >= low) & (sigma < high)).to_numpy(bool) for name, (low, high) in _SIGMAS_M.items()}
    return {name: _medians(closures, rows) for name, rows in classes.items() if rows.any()}


def _medians(closures: Closures, rows: np.ndarray) -> dict[str, Any]:
    errors = {f"{kind}_m": np.hypot(*closures.errors(kind)[rows, :2].T) for kind in (BUILT, PLACED)}
    causes = {cause: closures.rows[cause].to_numpy()[rows] for cause in ("given_m", "heading_m")}
    medians = {name: _median(values) for name, values in (errors | causes).items()}
    return {"registrations": int(rows.sum()), **medians}


def _median(values: np.ndarray) -> float | None:
    finite = values[np.isfinite(values)]
    return float(np.median(finite)) if len(finite) else None


def _dependence(by_submap: pd.DataFrame) -> dict[str, Any]:
    medians = {name: _median(by_submap[name].to_numpy()) for name in ("ratio", "worst_ratio")}
    terrain = DESCRIPTION[:3]
    return {**medians, **{name: _rank_correlation(by_submap[name], by_submap["ratio"]) for name in terrain}}


def _rank_correlation(a: pd.Series, b: pd.Series) -> float | None:
    if len(a) < intervals.FEWEST or a.nunique() < 2 or b.nunique() < 2:
        return None
    return float(stats.spearmanr(a, b).statistic)


def _by_method(survey: str, surveys: Mapping[str, Closures]) -> Iterator[tuple[str, dict[str, Any]]]:
    closures = surveys[survey]
    others = [other for name, other in surveys.items() if name != survey]
    for method in closures.methods:
        errors, q = closures.described(method)
        if len(errors) or len(closures.nodes(method)):
            elsewhere = [other.described(method) for other in others if method in other.methods]
            yield (
                method,
                {
                    **_placed(closures, method),
                    **_calibration(errors, q),
                    **_corrections(errors, q, [other for other in elsewhere if len(other[0])]),
                },
            )


def _placed(closures: Closures, method: str) -> dict[str, Any]:
    errors, q = closures.described(method, PLACED)
    measures = _calibration(errors, q)
    likelihood = gaussian.log_likelihood(errors[:, None], q)[:, 0] if len(errors) else np.empty(0)
    return {
        "placed_log_likelihood": float(likelihood.mean()) if len(errors) else None,
        "placed_log_likelihood_ci95": intervals.clustered(likelihood, closures.nodes(method)),
        "placed_median_m": _median(np.hypot(*errors[:, :2].T)),
        **{f"placed_{name}": measures.get(name) for name in _PLACED_MEASURES},
    }


def _calibration(errors: np.ndarray, q: np.ndarray) -> dict[str, float]:
    if not len(errors):
        return {}
    median = float(np.median(_squared(errors, q)) / stats.chi2.ppf(0.5, errors.shape[1]))
    measures = gaussian.calibration(errors[:, None], q)
    further = {"nees_median": median, "inflation": _inflation(errors, q), "birge": float(np.sqrt(measures["nees"]))}
    return {**measures, **further}


def _corrections(errors: np.ndarray, q: np.ndarray, elsewhere: Sequence[Errors]) -> dict[str, Any]:
    """Return the variance to add to Q here, and the coverage with what the other surveys' errors ask for."""
    if not len(errors):
        return {}
    numbers: dict[str, Any] = {"added_m2": _added(errors, q)}
    if elsewhere:
        others = [np.concatenate(parts) for parts in zip(*elsewhere, strict=True)]
        factor, variance = _inflation(*others), _added(*others)
        numbers["coverage_95_inflated"] = _coverage(errors, factor * q)
        numbers["coverage_95_added"] = None if variance is None else _coverage(errors, _widened(q, variance))
    return numbers


def _inflation(errors: np.ndarray, q: np.ndarray) -> float:
    return float(np.quantile(_squared(errors, q), _GOAL) / stats.chi2.ppf(_GOAL, errors.shape[1]))


def _added(errors: np.ndarray, q: np.ndarray) -> float | None:
    """Return the least variance to add, to 0.1 %.

    None where none is enough: nothing is added to yaw, whose own variance may be too small.
    """
    if _coverage(errors, q) >= _GOAL:
        return 0.0
    if _coverage(errors, _widened(q, _MOST_M2)) < _GOAL:
        return None
    low, high = np.log(_LEAST_M2), np.log(_MOST_M2)
    for _ in range(_HALVINGS):
        middle = (low + high) / 2
        low, high = (low, middle) if _coverage(errors, _widened(q, np.exp(middle))) >= _GOAL else (middle, high)
    return float(np.exp(high))


def _errors(rows: pd.DataFrame, kind: str) -> np.ndarray:
    names = [f"{kind}_{unit}" for unit in _UNITS if f"{kind}_{unit}" in rows]
    return rows[names].to_numpy(np.float64)


def _widened(q: np.ndarray, variance: float) -> np.ndarray:
    return np.asarray(q + variance * np.diag([1.0, 1.0, 0.0][: q.shape[-1]]))


def _coverage(errors: np.ndarray, q: np.ndarray) -> float:
    return float(np.mean(_squared(errors, q) <= stats.chi2.ppf(_GOAL, errors.shape[1])))


def _squared(errors: np.ndarray, q: np.ndarray) -> np.ndarray:
    return gaussian.squared_mahalanobis(errors[:, None], q)[:, 0]


def _rms(errors: np.ndarray) -> float | None:
    finite = errors[np.isfinite(errors).all(axis=1), :2]
    return float(np.sqrt((finite**2).sum(axis=1).mean())) if len(finite) else None
