"""The folder of a correction: maps, soundings, track, navigation files, parameters and the report."""

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import yaml

import pointnetkl
from pointnetkl.correction import maps, page, products
from pointnetkl.correction.preparation.inputs import Inputs
from pointnetkl.correction.result import Corrected
from pointnetkl.correction.settings import Settings
from pointnetkl.correction.solving import Solution, Solved
from pointnetkl.slam.closing import drift
from pointnetkl.slam.graph.pose_graph import DeadReckoningNoise
from pointnetkl.surveys import survey
from pointnetkl.workflow import artifacts

SIGNS = ("parameters.yaml", page.REPORT)  # files by which a result is known


def write(
    folder: Path, corrected: Corrected, solution: Solution, tables: Path, source: Inputs, settings: Settings
) -> None:
    """Write all products of a correction into a folder."""
    metadata = artifacts.table_metadata(tables / "pings.parquet")
    soundings = tables / "soundings.parquet"
    numbers = maps.write(
        folder, corrected, lambda: artifacts.read_groups(soundings, survey.SOUNDINGS), settings.cell_m or None
    )
    solved = solution.solved
    left = products.write(folder, corrected, edge_noise=_edges(solved) if solved else None)
    parameters = {
        "version": pointnetkl.__version__,
        "sources": [str(path) for path in source.sources],
        "settings": asdict(settings),
        "drift": asdict(solved.rates) if solved else None,
        "sampling": asdict(solved.pieces.sampling) if solved else None,
        "maps": asdict(numbers),
        "crs": corrected.crs,
        "origin": list(corrected.origin),
        "vertical": list(corrected.vertical),
        "verdict": asdict(corrected.verdict),
        "left_out": left,
    }
    text = yaml.safe_dump(_plain(parameters), sort_keys=False, allow_unicode=True, width=120)
    artifacts.write_bytes(folder / SIGNS[0], text.encode())
    page.write(folder, corrected, facts(corrected, solution, metadata.get("report", {}), left, text))


def facts(
    corrected: Corrected, solution: Solution, report: dict[str, Any], left: Sequence[str], parameters: str
) -> dict[str, Any]:
    """Return what the report tells beside the result."""
    solved = solution.solved
    told: dict[str, Any] = {
        "files": report.get("files"),
        "formats": ", ".join(report.get("formats", [])),
        "soundings": report.get("soundings"),
        "valid soundings": report.get("valid"),
        "left out by the reader": ", ".join(f"{n} {why}" for why, n in report.get("skipped", {}).items()),
        "depths are below": "; ".join(corrected.vertical) or "a level that the files do not name",
        "map": corrected.crs,
        "problems": [*(solved.notes if solved else []), *report.get("problems", [])],
        "products left out": list(left),
        "parameters": parameters,
        "version": pointnetkl.__version__,
    }
    if solved is not None:
        told["submaps"] = f"{len(solved.pieces.clouds)}; {solved.pieces.sampling.reason}"
        told["navigation"] = solved.reason
        told["drift assumed"] = corrected.verdict.drift
        told["rounds"] = solved.closed.rounds
        told["ties to known places"] = len(solved.anchors)
    if solution.cells is not None:
        told["disagreement_before_m"], told["disagreement_after_m"] = (c.difference_m for c in solution.cells)
    return told


def _edges(solved: Solved) -> list[DeadReckoningNoise]:
    """Return the noise of dead reckoning from submap to submap."""
    steps = np.hypot(*np.diff(solved.navigation.poses[:, :2], axis=0).T).tolist()
    times = np.diff(solved.navigation.time_s).tolist()
    return [drift.edge_noise(t, length, solved.rates) for t, length in zip(times, steps, strict=True)]


def _plain(value: Any) -> Any:
    """Return a value as YAML has it: NaN as null, arrays as lists."""
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, np.generic):
        return _plain(value.item())
    return None if isinstance(value, float) and not np.isfinite(value) else value
