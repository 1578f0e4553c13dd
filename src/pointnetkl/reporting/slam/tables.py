"""Tables of the SLAM benchmark: the paper's Table IV, errors over draws, variants, and the map's error by thinning."""

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import pandas as pd

from pointnetkl.reporting import paper
from pointnetkl.reporting.text_table import Block, Numbers, block, by_method, interval
from pointnetkl.slam.consistency.tables import THINNING
from pointnetkl.workflow import artifacts

_MEANS = ("draws_truth_rmse_xyz_m", "draws_truth_rmse_se2_m", "truth_relative_m")
_MINUS = ("", "_se2", "_relative")  # in the names of network's error less a method's
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
    """Return Table IV in the paper's form, a row per survey and error; against the truth too, where it is known."""
    rows = [row for name, numbers in slam.items() for row in _slam_rows(name, numbers, datasets[name])]
    graph = ("survey", "simulated", "track_km", "N_DR", "N_LC", "error_m", "of")
    return [block(caption, rows, [*graph, *paper.SLAM_METHODS])]


def slam_errors(slam: Numbers, datasets: Numbers) -> Block:
    """Return every method's SLAM errors in metres, and the paper's."""
    rows = [{**row, **interval(row.get("rmse_xyz_ci95_m")), **_paper_slam(row)} for row in by_method(slam, datasets)]
    aligned = ("xyz_m", "se2_m", "4dof_m")
    columns = ["survey", "simulated", "method", "rmse_xyz_m", "ci_low", "ci_high", "rmse_se2_m", "rmse_4dof_m"]
    columns += [*(f"truth_rmse_{how}" for how in aligned), "map_to_map_m", "map_to_map_auvlib_m", "pose_nees"]
    columns += ["paper_rmse_xyz_m", "paper_map_to_map_m"]
    caption = "SLAM error by method on the paper's graph, metres; the interval is of the mean over its noises."
    return block(caption, rows, columns)


def draws(slam: Numbers, datasets: Numbers) -> Block:
    """Return each method's errors against the truth over draws of the loop closures, and network's less them."""
    rows = [
        {
            **row,
            **{f"{side}_xyz": limit for side, limit in interval(row["draws_truth_rmse_xyz_ci95_m"]).items()},
            **{f"{side}_se2": limit for side, limit in interval(row["draws_truth_rmse_se2_ci95_m"]).items()},
            **{f"{side}_relative": limit for side, limit in interval(row["truth_relative_ci95_m"]).items()},
            **{f"{side}_minus{which}": limit for which in _MINUS for side, limit in _minus(row, which).items()},
        }
        for row in by_method(slam, datasets)
        if "draws_truth_rmse_xyz_m" in row
    ]
    columns = ["survey", "simulated", "method"]
    for mean, side, minus in zip(_MEANS, ("xyz", "se2", "relative"), _MINUS, strict=True):
        columns += [mean, f"ci_low_{side}", f"ci_high_{side}"]
        columns += [f"network_minus{minus}_m", f"ci_low_minus{minus}", f"ci_high_minus{minus}", f"network{minus}_p"]
    caption = (
        "SLAM error against the truth over draws of the loop closures, metres; 95 % t intervals over draws, and"
        " network's error less the method's, with its interval and the p-value (t test over draws) of its being below"
        " zero: above 0.975 network is significantly worse."
    )
    return block(caption, rows, columns)


def _minus(row: Numbers, which: str) -> dict[str, Any]:
    return interval(row.get(f"network_minus{which}_ci95_m"))


def variants(found: Numbers, datasets: Numbers) -> Block:
    """Return the variants' mean errors over draws by method, and how far from the table's (slam_summary.variants)."""
    rows = [
        {**row, "variant": variant, **interval(row.get("minus_table_ci95_m"))}
        for survey, of in found.items()
        for variant, methods in of.items()
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
    """Read what stage slam found of each survey in its folder, one table of schema THINNING."""
    every = [artifacts.read_table(folder / f"{name}_map_thinning.parquet", THINNING) for name in surveys]
    return pd.concat(every, ignore_index=True)


def thinning(found: pd.DataFrame, datasets: Numbers) -> Block:
    """Return each survey's map-to-map error at its GT by thinning (THINNING), and against none."""
    rows = []
    for survey, of in found.groupby("survey", sort=False):
        whole = of.loc[of["thinning"] == 1, "map_to_map_m"].iloc[0]
        known = {"survey": survey, "simulated": datasets[survey]["simulated"]}
        rows += [{**known, **row, "ratio": row["map_to_map_m"] / whole} for row in of.to_dict("records")]
    caption = "Map-to-map error at GT, metres, by thinning of the points that ask, or of both sides; ratio: to 1."
    columns = ["survey", "simulated", "thinning", "cells", "map_to_map_m", "ratio", "both_thinned_m"]
    return block(caption, rows, columns)


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
