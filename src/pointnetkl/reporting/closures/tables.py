"""Tables of how covariances describe loop closures: by method, and what each survey's loop closures are like."""

from pointnetkl.reporting.covariances.tables import COVERAGES
from pointnetkl.reporting.text_table import Block, Numbers, block, interval


def every(numbers: Numbers, datasets: Numbers) -> dict[str, list[Block]]:
    """Return the tables by the stem of their files; `numbers` are the report's."""
    sizes = numbers["closures"]
    return {
        "calibration_lc": [
            _by_method(numbers["calibration_lc"], numbers["calibration"], sizes, datasets),
            _by_survey(sizes, datasets),
            _by_hold(numbers["closures_by_hold"]),
            _ratios(numbers["closure_ratios"]),
        ]
    }


def _by_method(calibrations: Numbers, held_out: Numbers, sizes: Numbers, datasets: Numbers) -> Block:
    rows = [
        {
            "survey": survey,
            "simulated": datasets[survey]["simulated"],
            "against": sizes[survey]["against"],
            "method": method,
            **{f"held_out_{name}": held_out[survey].get(method, {}).get(name) for name in ("nees", "coverage_95")},
            **values,
            **interval(values["placed_log_likelihood_ci95"]),
        }
        for survey, methods in calibrations.items()
        for method, values in methods.items()
    ]
    columns = ["survey", "simulated", "against", "method", "placed_log_likelihood", "ci_low", "ci_high"]
    columns += ["nees", "nees_median", *COVERAGES, "placed_nees", "placed_nees_median", "placed_coverage_95"]
    columns += ["placed_median_m", "held_out_nees", "held_out_coverage_95", "inflation", "placed_inflation", "birge"]
    columns += ["placed_birge", "coverage_95_inflated", "added_m2", "coverage_95_added"]
    caption = (
        "Calibration on loop closures, all draws of the graph; measured_pair knows the truth, its placed_* are"
        " circular; split_recalibrated has a factor of the other test surveys; map's errors are MAP's, all others'"
        " GICP's."
    )
    return block(caption, rows, columns)


def _by_survey(sizes: Numbers, datasets: Numbers) -> Block:
    rows = [{"survey": name, "simulated": datasets[name]["simulated"], **size} for name, size in sizes.items()]
    columns = ["survey", "simulated", "against", "registrations", "submaps", "converged", "overlap", "patchiness"]
    columns += ["outside", "error_m", "gt_error_m", "placed_error_m", "given_m", "heading_m"]
    return block("The loop closures: medians, but errors, which are root mean squares in x, y.", rows, columns)


def _by_hold(holds: Numbers) -> Block:
    rows = [
        {"survey": survey, "sigma_of_Q_ij": sigma, **medians}
        for survey, classes in holds.items()
        for sigma, medians in classes.items()
    ]
    columns = ["survey", "sigma_of_Q_ij", "registrations", "error_m", "placed_error_m", "given_m", "heading_m"]
    return block("Errors and their causes by how well the common ground holds a submap, medians.", rows, columns)


def _ratios(ratios: Numbers) -> Block:
    rows = [
        {"survey": survey, "Q_i": method, **values}
        for survey, methods in ratios.items()
        for method, values in methods.items()
    ]
    columns = ["survey", "Q_i", "ratio", "worst_ratio", "overlap", "patchiness", "outside"]
    caption = "Q_ij over Q_i: medians of sqrt(tr Q_ij / tr Q_i) and in the worst direction; rank correlations of ratio."
    return block(caption, rows, columns)
