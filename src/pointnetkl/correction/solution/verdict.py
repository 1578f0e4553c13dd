"""Whether a correction helps: by closures left out in turn, and by the depths of overlapping passes."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy import stats

from pointnetkl.correction.result import Verdict
from pointnetkl.correction.settings import Settings
from pointnetkl.slam.closing.estimate import Closure, Estimate, linearised

_WORSE = 1.05  # of the overlaps' disagreement after to that before: more is harm
_AGREE = 1.5  # sigmas of their own, rms, that closures are off navigation: less is no contradiction
_FEW = 5  # closures with fewer of which leaving out says little
_MOST_NATS = 5.0  # that a closure counts
_TOGETHER = 3  # sources that follow each other
_PLAIN = 0.8  # of the overlaps' disagreement that is left, which settles it where closures are few


@dataclass(frozen=True)
class LeftOut:
    """A closure at navigation's poses, and where all others predict it: residuals (rank,), whitened by its own V."""

    before: np.ndarray
    after: np.ndarray
    variance_before: np.ndarray  # (rank, rank) of that residual, by the drift of navigation, and by the prediction
    variance_after: np.ndarray

    @property
    def gain(self) -> float:
        """Return how much more likely the prediction is than navigation, nats."""
        likelihoods = (
            np.linalg.slogdet(variance)[1] + r @ np.linalg.solve(variance, r)
            for r, variance in ((self.before, self.variance_before), (self.after, self.variance_after))
        )
        before, after = likelihoods
        return float(before - after) / 2


def left_out(navigation: Estimate, closures: Sequence[Closure]) -> list[LeftOut]:
    """Return each closure left out in turn.

    The prediction without a closure follows from S^-1 of all, S = J C J^T + I: with S^-1's block P of the closure its
    residual there is P^-1 (S^-1 r), of variance P^-1.
    """
    if not closures:
        return []
    J, r = linearised(closures, navigation.poses)
    S = J @ np.asarray((J @ navigation.covariance).T) + np.eye(len(r))
    inverse = np.linalg.inv(S)
    pull, ends = inverse @ r, np.cumsum([closure.rank for closure in closures]).tolist()
    rows = [slice(end - closure.rank, end) for end, closure in zip(ends, closures, strict=True)]
    variances = [np.linalg.inv(inverse[own, own]) for own in rows]
    return [LeftOut(r[own], P @ pull[own], S[own, own], P) for own, P in zip(rows, variances, strict=True)]


def information(closures: Sequence[Closure]) -> np.ndarray:
    """Return the trace of each closure's information (k,), 1/m^2."""
    return np.array([float(np.sum(closure.A**2)) for closure in closures])


@dataclass(frozen=True)
class Evidence:
    """What a verdict is made of."""

    navigation: Estimate  # before any closure
    closures: Sequence[Closure]  # accepted
    found: int  # returns to mapped ground
    disagreement_m: tuple[float, float]  # of passes, before and after
    variance_factor: float  # of the closures, by the drift that the survey was closed with
    drift: str  # in words
    refused: str = ""  # closures, by reason, in words
    # of positions that are absolute and as good as they are said to be, by their closures: in words; else empty
    as_good_as_said: str = ""


def judge(evidence: Evidence, settings: Settings) -> Verdict:
    """Return the verdict on a correction by its closures.

    A closure's error counts by its information, so that directions that ground hardly holds hardly count. Sources that
    follow each other share targets: they count together.
    """
    closures = evidence.closures
    each = left_out(evidence.navigation, closures)
    before = sum(float(one.before @ one.before) for one in each)
    after = sum(float(one.after @ one.after) for one in each)
    weight = float(information(closures).sum()) or np.nan
    left = float(np.sqrt(before / weight)), float(np.sqrt(after / weight))
    p = _by_chance(np.array([one.gain for one in each]), np.array([closure.tie.source for closure in closures]))
    sigmas = float(np.sqrt(before / max(sum(closure.rank for closure in closures), 1)))
    applied, why = _decided(evidence, left, p, sigmas, settings)
    numbers = (evidence.found, len(closures), *left, p, *evidence.disagreement_m, evidence.variance_factor)
    return Verdict(applied, why, *numbers, evidence.drift)


def _by_chance(gain: np.ndarray, source: np.ndarray) -> float:
    """Return the p-value that leaving out does not gain, by a t test over groups of sources; NaN of fewer than two.

    The gain is in nats, because a prediction far from other closures is not sure, and is not wrong where it is off.
    """
    # one gross closure must not decide
    of_group = pd.Series(np.clip(gain, -_MOST_NATS, _MOST_NATS)).groupby(source // _TOGETHER).mean()
    if len(of_group) < 2:
        return float("nan")
    if of_group.std() == 0:  # as large as counts in all of them, or nothing in any
        return float(of_group.mean() <= 0)
    return float(stats.ttest_1samp(of_group, 0.0, alternative="greater").pvalue)


def _decided(
    evidence: Evidence, left: tuple[float, float], p: float, sigmas: float, settings: Settings
) -> tuple[bool, str]:
    """Return whether a correction is applied, and the sentence that says so; `sigmas` closures are off navigation."""
    accepted, (before, after) = len(evidence.closures), evidence.disagreement_m
    overlaps = f"overlapping passes disagree by {after:.3g} m instead of {before:.3g} m"
    if not evidence.found:
        return False, "Left as it was: no part of the survey returns to ground that it has mapped before."
    returns = f"{_count(evidence.found, 'return')} to mapped ground"
    if not accepted:
        return False, f"Left as it was: of {returns} none could be used ({evidence.refused})."
    if evidence.as_good_as_said:
        return False, f"Left as it was: by {_count(accepted, 'loop closure')} {evidence.as_good_as_said}."
    if sigmas < _AGREE:
        agree = f"{_count(accepted, 'loop closure')} agree with navigation, to {left[0]:.2g} m"
        return False, f"Left as it was: {agree}, which is {sigmas:.1f} sigma of their own."
    if after > _WORSE * before:
        return False, f"Left as it was: with the correction {overlaps}, so it would make the map worse."
    if accepted < _FEW:
        plain = after < _PLAIN * before
        said = f"{accepted} of {returns} could be used, and {overlaps}" if before > 0 else f"{accepted} of {returns}"
        return plain, f"{'Corrected' if plain else 'Left as it was, for lack of closures'}: {said}."
    shown = left[1] <= (1 - settings.left_out_gain) * left[0] and p <= settings.left_out_p
    error = f"loop closures that are left out fit to {left[1]:.3g} m instead of {left[0]:.3g} m ({_percent(*left)})"
    error += f", and {overlaps} ({_percent(before, after)})" if before > 0 else ""
    return shown, f"Corrected: {error}." if shown else f"Left as it was: no gain is shown; {error}."


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}{'' if number == 1 else 's'}"


def _percent(before: float, after: float) -> str:
    share = 100 * (after / before - 1) if before > 0 else 0.0
    return f"{share:+.0f} %"
