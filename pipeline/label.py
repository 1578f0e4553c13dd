"""Label one survey's submaps: the covariance of GICP by Monte Carlo, and the error samples behind it."""

import argparse
from pathlib import Path

import numpy as np
import pandas as pd

from pointnetkl import artifacts, command, compute, gicp, label_summary, monte_carlo, settings, study, submap


def main(arguments: argparse.Namespace) -> None:
    """Write the survey's labels and error samples."""
    chosen = settings.read(arguments.params, "label", monte_carlo.Settings)
    registration = settings.read(arguments.params, "registration", gicp.Settings)
    runs = study.survey(arguments.params, arguments.survey).label_runs
    submaps = submap.from_table(arguments.survey, artifacts.read_table(arguments.submaps, submap.POINTS))

    def label(one: submap.Submap) -> monte_carlo.Label:
        return monte_carlo.label(one, runs, chosen, registration)

    labels = compute.over(label, submaps, f"label {arguments.survey}")
    rows = pd.DataFrame([one.row for one in labels], columns=monte_carlo.LABELS.names)
    parameters = {
        "survey": arguments.survey,
        "copy": chosen.copy,
        "label": settings.as_metadata(chosen),
        "registration": settings.as_metadata(registration),
    }
    samples = {
        "submap": rows["submap"].to_numpy(np.int32),
        "errors": np.stack([one.errors for one in labels]).astype(np.float32),
        "held_out": np.stack([one.held_out for one in labels]).astype(np.float32),
    }
    artifacts.write_table(arguments.labels, rows, monte_carlo.LABELS, parameters)
    artifacts.write_arrays(arguments.errors, samples, parameters)
    print(*label_summary.lines(arguments.survey, rows, chosen.prior_variance_m2**0.5), sep="\n")


if __name__ == "__main__":
    parser = command.parser(__doc__)
    parser.add_argument("survey")
    parser.add_argument("--submaps", type=Path, required=True)
    parser.add_argument("--labels", type=Path, required=True)
    parser.add_argument("--errors", type=Path, required=True)
    command.run(main, parser)
