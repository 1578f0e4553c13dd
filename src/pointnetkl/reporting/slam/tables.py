"""Tables of the SLAM benchmark beyond the paper's: over draws of the loop closures, and of its variants."""

from collections.abc import Iterator, Mapping
from typing import Any

from pointnetkl.reporting.tables import interval, table_4
from pointnetkl.reporting.text_table import Block, block

Numbers = Mapping[str, Any]
_MEANS = ("draws_truth_rmse_xyz_m", "draws_truth_rmse_se2_m", "truth_relative_m")
_MINUS = ("", "_se2", "_relative")  # in the names of network's error less a method's
_AUTHORS = "Table IV with the authors' two slips, from the same graphs and noises, metres."


def every(numbers: Numbers, datasets: Numbers) -> dict[str, list[Block]]:
    """Return the tables by the stem of their files; `numbers` as the report has them."""
    return {
        "table_4_authors": table_4(numbers["slam_authors"], datasets, _AUTHORS),
        "slam_draws": [draws(numbers["slam"], datasets)],
        "slam_variants": [variants(numbers["slam_variants"], datasets)],
    }


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
        for row in _methods(slam, datasets)
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
        for row in _methods({survey: methods}, datasets)
    ]
    columns = ["survey", "simulated", "method", "variant", "rmse_xyz_m", "truth_rmse_xyz_m", "truth_rmse_se2_m"]
    columns += ["truth_relative_m", "minus_table_m", "ci_low", "ci_high"]
    caption = (
        "Edges counted all or once a registration, and the authors' slips: mean error over draws, metres;"
        " minus_table is of truth_rmse_xyz_m, with a 95 % t interval over draws."
    )
    return block(caption, sorted(rows, key=lambda row: (row["survey"], row["method"])), columns)


def _methods(numbers: Numbers, datasets: Numbers) -> Iterator[dict[str, Any]]:
    for survey, methods in numbers.items():
        for method, values in methods.items():
            if isinstance(values, Mapping):
                yield {"survey": survey, "simulated": datasets[survey]["simulated"], "method": method, **values}
