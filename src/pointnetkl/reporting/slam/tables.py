"""Tables of the SLAM benchmark: the paper's Table IV, errors over draws, variants, and the map's error by thinning."""

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import pandas as pd

from pointnetkl.reporting import paper
from pointnetkl.reporting.text_table import Block, Numbers, block, by_method, interval
from pointnetkl.slam.consistency.schemas import THINNING
from pointnetkl.workflow import artifacts

_OVER_DRAWS = {  # by end of the columns' names: the mean's name, and the end of the names of a comparison with network
    "xyz": ("draws_truth_rmse_xyz", ""),
    "se2": ("draws_truth_rmse_se2", "_se2"),
    "relative": ("truth_relative", "_relative"),
}
_AUTHORS = "Table IV with the authors' two slips, from the same graphs and noises, metres."


def every(numbers: Numbers, map_thinning: pd.DataFrame, datasets: Numbers) -> dict[str, list[Block]]:
    """Return the tables by the stems of their files; `map_thinning` has the schema THINNING."""
    errors, by_draw = slam_errors(numbers["slam"], datasets), draws(numbers["slam"], datasets)
    return {
        "table_4": [*table_4(numbers["slam"], datasets), errors, by_draw],
        "slam": [errors],
        "table_4_authors": table_4(numbers["slam_authors"], datasets, _AUTHORS),
        "slam_draws": [by_draw],
        "slam_variants": [variants(numbers["slam_variants"], datasets)],
        "map_thinning": [thinning(map_thinning, datasets)],
    }


def table_4(
    slam: Numbers, datasets: Numbers, caption: str = "Table IV. Error of the optimised graphs, metres."
) -> list[Block]:
    """Return Table IV in the paper's form: a row per survey and error, also against the truth where it is known."""
    rows = [row for name, numbers in slam.items() for row in _slam_rows(name, numbers, datasets[name])]
    graph = ("survey", "simulated", "track_km", "N_DR", "N_LC", "error_m", "of")
    return [block(caption, rows, [*graph, *paper.SLAM_METHODS])]


def slam_errors(slam: Numbers, datasets: Numbers) -> Block:
    """Return each method's SLAM errors in metres, beside the paper's."""
    rows = [{**row, **interval(row.get("rmse_xyz_ci95_m")), **_paper_slam(row)} for row in by_method(slam, datasets)]
    columns = ["survey", "simulated", "method", "rmse_xyz_m", "ci_low", "ci_high", "rmse_se2_m", "rmse_4dof_m"]
    columns += ["truth_rmse_xyz_m", "truth_rmse_se2_m", "truth_rmse_4dof_m"]
    columns += ["map_to_map_m", "map_to_map_auvlib_m", "pose_nees"]
    columns += ["paper_rmse_xyz_m", "paper_map_to_map_m"]
    caption = "SLAM error by method on the paper's graph, metres; the interval is of the mean over its noises."
    return block(caption, rows, columns)


def draws(slam: Numbers, datasets: Numbers) -> Block:
    """Return each method's errors against the truth over draws of the loop closures, and network's less the method's.

    `slam` has the results of `numbers.summarise` by survey.
    """
    rows = [{**row, **_limits(row)} for row in by_method(slam, datasets) if "draws_truth_rmse_xyz_m" in row]
    columns = ["survey", "simulated", "method"]
    for end, (mean, minus) in _OVER_DRAWS.items():
        columns += [f"{mean}_m", f"ci_low_{end}", f"ci_high_{end}"]
        columns += [f"network_minus{minus}_m", f"ci_low_minus{minus}", f"ci_high_minus{minus}", f"network{minus}_p"]
    caption = (
        "SLAM error against the truth over draws of the loop closures, metres; 95 % t intervals over draws, and"
        " network's error less the method's, with its interval and the p-value (t test over draws) of its being below"
        " zero: above 0.975 network is significantly worse."
    )
    return block(caption, rows, columns)


def variants(slam_variants: Numbers, datasets: Numbers) -> Block:
    """Return the variants' mean errors over draws by method, and how far they are from the variant `table`.

    `slam_variants` has the results of `numbers.variants` by survey.
    """
    rows = [
        {**row, "variant": variant, **interval(row.get("minus_table_ci95_m"))}
        for survey, variants in slam_variants.items()
        for variant, methods in variants.items()
        for row in by_method({survey: methods}, datasets)
    ]
    columns = ["survey", "simulated", "method", "variant", "rmse_xyz_m", "truth_rmse_xyz_m", "truth_rmse_se2_m"]
    columns += ["truth_relative_m", "minus_table_m", "ci_low", "ci_high"]
    caption = (
        "Edges counted all or once a registration, and the authors' slips: mean error over draws, metres;"
        " minus_table is of truth_rmse_xyz_m, with a 95 % t interval over draws."
    )
    return block(caption, sorted(rows, key=lambda row: (row["survey"], row["method"])), columns)


def read_thinning(folder: Path, surveys: Iterable[str]) -> pd.DataFrame:
    """Read the surveys' map-to-map errors by thinning from stage slam's folder: one table of schema THINNING.

    Raises:
        ArtifactError: a table is missing or damaged.
    """
    tables = [artifacts.read_table(folder / f"{name}_map_thinning.parquet", THINNING) for name in surveys]
    return pd.concat(tables, ignore_index=True)


def thinning(map_thinning: pd.DataFrame, datasets: Numbers) -> Block:
    """Return each survey's map-to-map error at its GT by thinning, and its ratio to the error without thinning.

    `map_thinning` has the schema THINNING.
    """
    rows = []
    for survey, errors in map_thinning.groupby("survey", sort=False):
        whole = errors.loc[errors["thinning"] == 1, "map_to_map_m"].iloc[0]
        simulated = datasets[survey]["simulated"]
        rows += [
            {**row, "simulated": simulated, "ratio": row["map_to_map_m"] / whole} for row in errors.to_dict("records")
        ]
    caption = "Map-to-map error at GT, metres, by thinning of the points that ask, or of both sides; ratio: to 1."
    columns = ["survey", "simulated", "thinning", "cells", "map_to_map_m", "ratio", "both_thinned_m"]
    return block(caption, rows, columns)


def _limits(row: Numbers) -> dict[str, Any]:
    """Return the ends of a method's intervals over draws, by the names of their columns."""
    limits: dict[str, Any] = {}
    for end, (mean, minus) in _OVER_DRAWS.items():
        limits |= {f"{side}_{end}": limit for side, limit in interval(row[f"{mean}_ci95_m"]).items()}
        ci95 = interval(row.get(f"network_minus{minus}_ci95_m"))
        limits |= {f"{side}_minus{minus}": limit for side, limit in ci95.items()}
    return limits


def _paper_slam(row: Numbers) -> dict[str, Any]:
    if row["survey"] not in paper.SLAM:
        return {}
    theirs = paper.SLAM[row["survey"]]
    errors = {"paper_rmse_xyz_m": theirs.rmse_xyz_m, "paper_map_to_map_m": theirs.map_to_map_m}
    return {column: values.get(row["method"]) for column, values in errors.items()}


def _slam_rows(survey: str, ours: Numbers, dataset: Numbers) -> Iterator[dict[str, Any]]:
    theirs = paper.SLAM.get(survey)
    graph = {"simulated": dataset["simulated"], "track_km": dataset["track_km"]}
    graph |= {"N_DR": ours["dead_reckoning_edges"], "N_LC": ours["loop_closures"]}
    for name, error in (
        ("rmse_xyz_m", "RMSE_xyz, GT"),
        ("truth_rmse_xyz_m", "RMSE_xyz, truth"),
        ("map_to_map_m", "map-to-map"),
    ):
        methods = {method: ours.get(method, {}).get(name) for method in paper.SLAM_METHODS}
        yield {"survey": survey, **graph, "error_m": error, "of": "ours", **methods}
        if theirs and hasattr(theirs, name):
            edges = {"N_DR": theirs.dead_reckoning_edges, "N_LC": theirs.loop_closures}
            size = {"simulated": False, "track_km": theirs.track_km, **edges}
            yield {"survey": survey, **size, "error_m": error, "of": "paper", **getattr(theirs, name)}
