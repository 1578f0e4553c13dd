"""Label one survey's submaps: the covariance of GICP by Monte Carlo, and the error samples behind it."""

import pointnetkl.workflow.blas  # noqa: F401 - before NumPy is loaded

# isort: split
import argparse
import dataclasses
from pathlib import Path

import numpy as np
import pandas as pd

from pointnetkl.labels import shards, warnings
from pointnetkl.registration import gicp, monte_carlo
from pointnetkl.registration.covariance import label_table
from pointnetkl.workflow import artifacts, command, parameters, study


def main(arguments: argparse.Namespace) -> None:
    """Write the survey's labels and error samples."""
    settings = parameters.read(arguments.params, "label", monte_carlo.Settings)
    registration = parameters.read(arguments.params, "registration", gicp.Settings)
    line = study.survey(arguments.params, arguments.survey)
    if line.group == "train":  # calibration is judged on test surveys alone
        settings = dataclasses.replace(settings, held_out_runs=0)
    submaps, folder = arguments.submaps.resolve(), arguments.shards.resolve()  # workers may have another current folder
    kernel = shards.kernel_version(settings.engine)
    job = shards.Job(arguments.survey, submaps, folder, line.label_runs, settings, registration, kernel)
    labels, computed = shards.labels(job)
    print(f"{arguments.survey}: labelled {computed}, {len(labels) - computed} were there")
    schema = label_table.schema(registration.dimensions)
    rows = pd.DataFrame([label.row for label in labels], columns=schema.names)
    metadata = {
        "survey": arguments.survey,
        "copy": settings.copy,
        "label": parameters.as_metadata(settings),
        "registration": parameters.as_metadata(registration),
    }
    samples = {
        "submap": rows["submap"].to_numpy(np.int32),
        "errors": padded([label.errors for label in labels]),
        "held_out": np.stack([label.held_out for label in labels]),
    }
    artifacts.write_table(arguments.labels, rows, schema, metadata)
    artifacts.write_arrays(arguments.errors, samples, metadata)
    prior_sigma_m, target = settings.prior_variance_m2**0.5, settings.target_relative_error
    print(*warnings.lines(arguments.survey, rows, prior_sigma_m, target), sep="\n")


def padded(errors: list[np.ndarray]) -> np.ndarray:
    """Return errors (L, M) of n submaps as one array (n, longest L, M), NaN where a submap stopped earlier."""
    array = np.full((len(errors), max(map(len, errors)), errors[0].shape[1]), np.nan, np.float32)
    for i, rows in enumerate(errors):
        array[i, : len(rows)] = rows
    return array


if __name__ == "__main__":
    parser = command.parser(__doc__)
    parser.add_argument("survey", help="the survey's name in study.surveys")
    parser.add_argument("--submaps", type=Path, required=True, help="points of the survey's submaps, Parquet")
    parser.add_argument("--shards", type=Path, required=True, help="folder that keeps labels as they are computed")
    parser.add_argument("--labels", type=Path, required=True, help="labels to write, Parquet")
    parser.add_argument("--errors", type=Path, required=True, help="error samples to write, npz")
    command.run(main, parser)
