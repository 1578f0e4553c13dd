"""A survey cut, closed and judged: from its tables to what its track is corrected by."""

import dataclasses
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from pointnetkl.correction import settings as rates_of
from pointnetkl.correction.preparation import cut, inputs, navigation, reference
from pointnetkl.correction.preparation.cut import Cut
from pointnetkl.correction.preparation.inputs import Inputs
from pointnetkl.correction.products import ties
from pointnetkl.correction.result import CorrectionError, Verdict
from pointnetkl.correction.scratch import Scratch
from pointnetkl.correction.settings import DEAD_RECKONING, Settings
from pointnetkl.correction.solution import belief, closing, closures, disagreement, given
from pointnetkl.correction.solution import verdict as verdicts
from pointnetkl.correction.solution.belief import Navigation
from pointnetkl.correction.solution.disagreement import Cells
from pointnetkl.segmentation import SegmentationError
from pointnetkl.slam.closing import drift, survey
from pointnetkl.slam.closing import solving as least_squares
from pointnetkl.slam.closing.estimate import Closure, Estimate, from_matrices, to_matrices
from pointnetkl.slam.closing.schemas import State
from pointnetkl.slam.closing.survey import Closed
from pointnetkl.surveys import submap
from pointnetkl.surveys import survey as surveys

_STILL_M = 1e-3  # a track that has moved by less has not moved
_START_M = 10.0  # standard deviation of where dead reckoning begins, if places are known that can tell

_REASONS = {
    State.FLAT: "on ground too flat to tell a place",
    State.UNMATCHED: "without enough matches",
    State.RESIDUALS: "whose points do not fit",
    State.PREDICTION: "that contradict navigation and the others",
    State.OUTVOTED: "outvoted by the others",
}

Metadata = Mapping[str, Any]  # of the survey's tables


@dataclass(frozen=True)
class Solved:
    """A survey cut and closed, and what its track is corrected by."""

    pieces: Cut
    navigation: Navigation
    reason: str  # why that is what navigation is, in words
    rates: drift.Settings  # of drift, that it was closed with
    anchors: Sequence[Closure]  # ties to what is known beforehand
    closed: Closed
    notes: Sequence[str]  # on what was refused
    estimate: Estimate  # that is applied: of anchors and closures, or of anchors alone
    held: Sequence[Closure]  # what it is made of


@dataclass(frozen=True)
class Solution:
    """The verdict on a survey, and how it came about; None where the survey cannot be cut or has no track."""

    verdict: Verdict
    solved: Solved | None = None
    cells: tuple[Cells, Cells] | None = None  # that passes share, before and after


def nothing(sentence: str) -> Solution:
    """Return the solution of a survey that has nothing to close."""
    nan = float("nan")
    return Solution(Verdict(False, sentence, 0, 0, nan, nan, nan, nan, nan, nan, ""))


def check(source: Inputs, settings: Settings) -> None:
    """Refuse rates of drift, fixes and ties that cannot be, before hours are spent on the rest.

    Raises:
        CorrectionError, DriftError, TieError: they cannot be.
    """
    rates_of.rates(settings, source.rates)
    if source.fixes is not None:
        belief.read_fixes(source.fixes)
    if source.ties is not None:
        ties.read(source.ties)


def solve(
    source: Inputs, name: str, tables: Path, pings: pd.DataFrame, scratch: Scratch, settings: Settings
) -> Solution:
    """Return the survey of a folder's tables cut, closed and judged; with a reason instead where it cannot be.

    Raises:
        CorrectionError: what is given beside it does not fit it.
        ClosingError: the poses have no solution.
    """
    metadata = inputs.metadata(tables)
    if (kind := metadata["kind"]) == surveys.POINTS:
        return nothing("Left as it was: points without pings have no track to correct.")
    try:
        folder = scratch.step("submaps", lambda made: _cut(source, name, tables, kind, settings, made))
    except SegmentationError as error:
        return nothing(f"Left as it was: {cut.reason(error)}.")
    pieces = cut.read(folder)
    sailed, reason = _navigation(source, pings, pieces, metadata, settings)
    known = _anchors(source, metadata, pings, sailed)
    anchors = belief.trusted(sailed, known, settings.closing.search.gates)
    notes = []
    if refused := len(known) - len(anchors):
        notes = [f"{refused} of {len(known)} places and ties that were given contradict the others: refused"]
        print(*notes)
    stored = scratch.step("closures", lambda made: _close(source, metadata, pieces, sailed, anchors, settings, made))
    rates, closed = _kept(stored, pieces, sailed, anchors, settings)
    solved = Solved(pieces, sailed, reason, rates, anchors, closed, notes, closed.estimate, [])
    return _judged(solved, settings)


def _cut(source: Inputs, name: str, tables: Path, kind: str, settings: Settings, folder: Path) -> None:
    if source.submaps is not None:
        cut.from_stage(*source.submaps, folder)
    else:
        cut.cut(name, tables, kind, settings, folder)


def _navigation(
    source: Inputs, pings: pd.DataFrame, pieces: Cut, metadata: Metadata, settings: Settings
) -> tuple[Navigation, str]:
    """Return the navigation of a survey's submaps, and what it is in words."""
    times = pieces.poses["time_s"].to_numpy()
    if (again := np.flatnonzero(np.diff(times) <= 0)).size:
        raise CorrectionError(
            f"submaps {again[0]} and {again[0] + 1} are of one time, {times[again[0]]:.3f} s; are two vehicles' lines"
            " in one survey? Correct each by itself"
        )
    kind, first = navigation.kind(source, settings, pings, metadata), pings.iloc[0]
    begins, rates = kind.name == DEAD_RECKONING, kind.rates
    fix = drift.Fix(*(float(first[key]) for key in ("time_s", "x_m", "y_m"))) if begins else None
    if begins and (source.fixes or source.reference):  # else known places could but bend a track whose begin is fixed
        rates = dataclasses.replace(rates, start_m=_START_M)
    poses = from_matrices(submap.poses_from_table(pieces.poses))
    return Navigation(times, poses, rates, fix, kind.name == "gnss"), f"{kind.name}: {kind.reason}"


def _anchors(source: Inputs, metadata: Metadata, pings: pd.DataFrame, sailed: Navigation) -> list[Closure]:
    """Return what is known beforehand: files that are held, fixes of position, and ties that the user gives."""
    frame = metadata["crs"], (float(metadata["origin"][0]), float(metadata["origin"][1]))
    anchors = belief.held(source.held, pings, sailed) if source.held else []
    if source.fixes is not None:
        anchors += belief.fixes(source.fixes, *frame, pings, sailed)
    if source.ties is not None:
        anchors += given.closures(source.ties, *frame, pings, sailed)
    return anchors


def _close(
    source: Inputs,
    metadata: Metadata,
    pieces: Cut,
    sailed: Navigation,
    anchors: Sequence[Closure],
    settings: Settings,
    folder: Path,
) -> None:
    """Find the closures of a survey, and write them to a folder."""
    poses = submap.poses_from_table(pieces.poses)
    problem = closing.Problem(
        pieces.clouds,
        poses,
        sailed,
        pieces.spacing_m,
        _closing(pieces, settings),
        rates_of.registration(pieces.spacing_m),
        anchors,
        reference.under(source.reference, metadata, pieces, poses, folder) if source.reference else None,
    )
    closed, rates = closing.close(problem, measure_drift=not settings.drift)
    closures.save(folder / "closures.npz", closed.found, {"rates": dataclasses.asdict(rates), "rounds": closed.rounds})


def _kept(
    folder: Path, pieces: Cut, sailed: Navigation, anchors: Sequence[Closure], settings: Settings
) -> tuple[drift.Settings, Closed]:
    """Return the rates of drift and the closures of a folder that `_close` has written, solved."""
    found, kept = closures.load(folder / "closures.npz")
    rates = drift.Settings(**kept["rates"])
    start = least_squares.solve(Estimate(sailed.poses, sailed.covariance(rates)), anchors)
    judged, estimate = survey.judge(start, found, _closing(pieces, settings))
    poses = to_matrices(estimate.poses, submap.poses_from_table(pieces.poses))
    return rates, Closed(poses, start, estimate, judged, int(kept["rounds"]))


def _closing(pieces: Cut, settings: Settings) -> survey.Settings:
    return settings.close(pieces.spacing_m, float(np.median(pieces.clouds.counts)))


def _judged(solved: Solved, settings: Settings) -> Solution:
    """Return the verdict: on the closures, or else on what is known beforehand alone."""
    pieces, closed, sailed = solved.pieces, solved.closed, solved.navigation
    poses = submap.poses_from_table(pieces.poses)

    def measured(T: np.ndarray) -> Cells:
        return disagreement.measure(pieces.clouds, T, pieces.passes, pieces.spacing_m)

    before, after = measured(poses), measured(closed.poses)
    evidence = verdicts.Evidence(
        closed.navigation,
        closed.accepted,
        len(closed.found),
        (before.rms_m, after.rms_m),
        closed.variance_factor,
        rates_of.words(solved.rates),
        _refused(closed),
        _as_good_as_said(sailed, closed),
    )
    verdict = verdicts.judge(evidence, settings)
    if verdict.applied:
        held = [*solved.anchors, *closed.accepted]
        return Solution(verdict, dataclasses.replace(solved, held=held), (before, after))
    start = closed.navigation
    moved = float(np.sqrt(((start.poses - sailed.poses)[:, :2] ** 2).sum(axis=1).mean()))
    if moved > _STILL_M:
        after = measured(to_matrices(start.poses, poses))
        given_alone = f"Corrected by what was given alone, by {moved:.3g} m (rms)"
        alone = f"{given_alone}; of the survey's own closures: {verdict.sentence.split(': ', 1)[-1]}"
        verdict = dataclasses.replace(verdict, applied=True, sentence=alone, disagreement_after_m=after.rms_m)
    return Solution(verdict, dataclasses.replace(solved, held=solved.anchors, estimate=start), (before, after))


def _refused(closed: Closed) -> str:
    """Return in words how many closures were not accepted, by reason."""
    counts = Counter(_REASONS[f.state] for f in closed.found if f.state != State.ACCEPTED)
    return ", ".join(f"{count} {reason}" for reason, count in counts.most_common())


def _as_good_as_said(sailed: Navigation, closed: Closed) -> str:
    """Return in words that positions of a satellite receiver are as good as they are said to be; empty if not."""
    if not sailed.exact or not closed.accepted:
        return ""
    said = Estimate(sailed.poses, sailed.covariance())
    if closing.excess(said, closed.accepted) > 1:
        return ""
    return (
        f"positions are as good as they are said to be ({sailed.rates.position_walk_m:.2g} m); say"
        " --drift position_walk_m=NUMBER if they should be better"
    )
