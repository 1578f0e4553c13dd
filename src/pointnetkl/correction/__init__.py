"""A survey corrected: raw lines in, a track and a map that agree with themselves out.

`correct` reads, cuts and closes a survey, judges the correction, and writes a folder that appears whole. What it has
finished is kept beside that folder until then, so that a killed run goes on where it was.
"""

from pathlib import Path
from typing import Any

import pandas as pd

from pointnetkl.correction import delivery, solving
from pointnetkl.correction.preparation import inputs
from pointnetkl.correction.preparation.inputs import Inputs
from pointnetkl.correction.result import CLOSURES, Corrected, CorrectionError, Submaps
from pointnetkl.correction.scratch import Scratch
from pointnetkl.correction.settings import Settings
from pointnetkl.correction.solution import closures, track
from pointnetkl.correction.solving import Solution, Solved
from pointnetkl.slam.closing.estimate import to_matrices
from pointnetkl.surveys import submap, survey
from pointnetkl.workflow import artifacts

__all__ = ["Corrected", "CorrectionError", "Inputs", "Settings", "correct"]


def correct(source: Inputs, out: Path, settings: Settings, replace: bool = False) -> Corrected:
    """Correct a survey, and write its products to a folder, which appears whole at the end.

    Args:
        source: the survey, and what is known of it.
        out: the folder to make.
        settings: how it is corrected.
        replace: whether a folder that is there already may be replaced.

    Raises:
        CorrectionError: an input is missing, the folder is there, or it cannot be written.
        PointNetKLError: the survey cannot be read or closed.
    """
    inputs.check(source, out)
    solving.check(source, settings)
    _require_room(out, replace)
    scratch = Scratch(out, source.key(settings))
    try:
        return _corrected(scratch, source, out, settings)
    finally:
        scratch.leave()


def _require_room(out: Path, replace: bool) -> None:
    if not out.exists() or (out.is_dir() and not any(out.iterdir())):
        return
    if not replace:
        raise CorrectionError(f"{out}: is there already; give --replace to have it replaced, or another folder")
    if not out.is_dir() or not all((out / name).is_file() for name in delivery.SIGNS):
        raise CorrectionError(
            f"{out}: is no result of an earlier correction, and is not replaced; choose another folder"
        )


def _corrected(scratch: Scratch, source: Inputs, out: Path, settings: Settings) -> Corrected:
    name = source.sources[0].stem or source.sources[0].resolve().name
    tables = source.ingested or scratch.step("survey", lambda folder: inputs.ingest(source, name, settings, folder))
    metadata = inputs.metadata(tables)
    pings = artifacts.read_table(tables / "pings.parquet", survey.PINGS)
    solution = solving.solve(source, name, tables, pings, scratch, settings)
    corrected = _result(name, metadata, pings, solution)
    scratch.step("products", lambda folder: delivery.write(folder, corrected, solution, tables, source, settings))
    scratch.deliver("products", out)
    return corrected


def _result(name: str, metadata: dict[str, Any], pings: pd.DataFrame, solution: Solution) -> Corrected:
    """Return the survey's track with the correction, if it is applied."""
    solved = solution.solved
    if solved is None:
        table, submaps, found = track.unmoved(pings), None, CLOSURES.empty_table().to_pandas()
    else:
        knots = track.solve(pings, solved.navigation, solved.rates, solved.held, solved.estimate.poses)
        table, submaps = track.table(pings, knots), _submaps(solved)
        spacing_m, applied = solved.pieces.spacing_m, len(solved.held) > len(solved.anchors)
        found = closures.table(solved.closed, solved.estimate.poses, submaps.time_s, spacing_m, applied)
    east, north = metadata["origin"]
    return Corrected(
        name=name,
        kind=metadata["kind"],
        crs=metadata["crs"],
        origin=(float(east), float(north)),
        vertical=metadata.get("report", {}).get("vertical", []),
        track=table,
        submaps=submaps,
        closures=found,
        verdict=solution.verdict,
    )


def _submaps(solved: Solved) -> Submaps:
    poses = solved.pieces.poses
    before = submap.poses_from_table(poses)
    return Submaps(
        number=poses["submap"].to_numpy(),
        time_s=poses["time_s"].to_numpy(),
        line=poses["line"].to_numpy(),
        before=before,
        after=to_matrices(solved.estimate.poses, before),
        covariance=solved.estimate.marginals,
        length_m=solved.pieces.sampling.length_m,
        spacing_m=solved.pieces.spacing_m,
    )
