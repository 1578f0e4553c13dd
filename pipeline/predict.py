"""Covariances of one survey's submaps by the methods that learned from the labels of the training surveys."""

import pointnetkl.workflow.blas  # noqa: F401 - before NumPy is loaded

# isort: split
import argparse
from pathlib import Path

from pointnetkl.methods.fitted import learned
from pointnetkl.models import trained
from pointnetkl.registration.covariance import method, table
from pointnetkl.surveys import submap
from pointnetkl.workflow import artifacts, command, parameters, study


def main(arguments: argparse.Namespace) -> None:
    """Write the survey's covariance table."""
    settings = parameters.read(arguments.params, "predict", learned.Settings)
    fits = learned.read(arguments.fits)
    artifacts.require_survey(arguments.survey, arguments.submaps)
    submaps = submap.from_table(arguments.survey, artifacts.read_table(arguments.submaps, submap.POINTS))
    paths = [arguments.models / f"{name}.pt" for name in study.read(arguments.params).models]
    models = trained.load_all(paths, fits.label, fits.registration)
    covariances = method.tabulate([*learned.methods(fits, settings.seed), *models], submaps)
    sections = {"predict": settings, "label": fits.label, "registration": fits.registration}
    params = {section: parameters.as_metadata(values) for section, values in sections.items()}
    metadata = {"survey": arguments.survey, "params": params}
    artifacts.write_table(arguments.covariances, covariances, table.schema(fits.registration.dimensions), metadata)


if __name__ == "__main__":
    parser = command.parser(__doc__)
    parser.add_argument("survey", help="the survey's name in study.surveys")
    parser.add_argument("--submaps", type=Path, required=True)
    parser.add_argument("--models", type=Path, required=True, help="folder of the trained ones")
    parser.add_argument("--fits", type=Path, required=True)
    parser.add_argument("--covariances", type=Path, required=True)
    command.run(main, parser)
