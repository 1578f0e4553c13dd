"""The rivals that learn a few numbers from the labels of the training surveys."""

import pointnetkl.workflow.blas  # noqa: F401 - before NumPy is loaded

# isort: split
import argparse
import dataclasses
from pathlib import Path

import numpy as np

from pointnetkl.methods.closed_forms.self_registration import SelfRegistration
from pointnetkl.methods.fitted import fitting, learned
from pointnetkl.registration import gicp, monte_carlo
from pointnetkl.registration.covariance import label_table
from pointnetkl.surveys import submap
from pointnetkl.workflow import artifacts, command, parameters, study


def main(arguments: argparse.Namespace) -> None:
    """Fit every method, write the numbers and print them."""
    settings = parameters.read(arguments.params, "fit", fitting.Settings)
    surveys = study.training_surveys(arguments.params)
    label, registration = read_settings([arguments.training / name / "labels.parquet" for name in surveys])
    setup = SelfRegistration(settings.seed, label, registration)
    fits = learned.fit(read_training(arguments.training, surveys, setup), settings)
    learned.write(arguments.fits, fits, {"fit": parameters.as_metadata(settings), "surveys": surveys})
    for name, fit in fits.fits.items():
        numbers = ", ".join(f"{key} {value:.4g}" for key, value in fit.numbers.items())
        print(f"{name}: {numbers}; mean KL {fit.mean_kl:.4f} nats over {fits.submaps} training submaps")


def read_settings(paths: list[Path]) -> tuple[monte_carlo.Settings, gicp.Settings]:
    """Return the settings that made the labels of all files, which must be the same."""
    made_with = []
    for path in paths:
        metadata = artifacts.table_metadata(path)
        label = parameters.from_metadata(metadata, "label", monte_carlo.Settings, path)
        registration = parameters.from_metadata(metadata, "registration", gicp.Settings, path)
        made_with.append((label, registration))
        if made_with[-1] != made_with[0]:
            raise fitting.FittingError(f"{path}: was made with other settings than {paths[0]}; run dvc repro label")
    return made_with[0]


def read_training(folder: Path, surveys: list[str], setup: SelfRegistration) -> fitting.Training:
    """Read every training survey's submaps and labels; an error names the first file that is missing."""
    # a group of rows at a time: the whole table of a large survey beside its submaps is too much
    streams = [submap.stream(name, folder / name / "submaps.parquet") for name in surveys]
    submaps = [[s if setup.label.copy == "split" else without_halves(s) for s in stream] for stream in streams]
    columns = label_table.schema(setup.registration.dimensions)
    labels = [artifacts.read_table(folder / name / "labels.parquet", columns) for name in surveys]
    return fitting.training(submaps, labels, setup)


def without_halves(whole: submap.Submap) -> submap.Submap:
    """Return a submap without the halves of its points, which only labels of copy split look at: they fill memory."""
    none = np.empty((0, 3))
    return dataclasses.replace(whole, first=none, second=none)


if __name__ == "__main__":
    parser = command.parser(__doc__)
    parser.add_argument("--training", type=Path, required=True, help="a folder for each training survey")
    parser.add_argument("--fits", type=Path, required=True)
    command.run(main, parser)
