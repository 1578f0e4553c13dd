"""Covariances of one survey's submaps by the methods that learned from the labels of the training surveys."""

import argparse
from pathlib import Path

from pointnetkl.methods.closed_forms.self_registration import SelfRegistration
from pointnetkl.methods.fitted import learned
from pointnetkl.models import trained
from pointnetkl.registration import gicp, monte_carlo
from pointnetkl.registration.covariance import method, table
from pointnetkl.surveys import submap
from pointnetkl.workflow import artifacts, command, parameters


def main(arguments: argparse.Namespace) -> None:
    """Write the survey's covariance table."""
    chosen = parameters.read(arguments.params, "predict", learned.Settings)
    label = parameters.read(arguments.params, "label", monte_carlo.Settings)
    registration = parameters.read(arguments.params, "registration", gicp.Settings)
    how = SelfRegistration(chosen.seed, label, registration)
    submaps = submap.from_table(arguments.survey, artifacts.read_table(arguments.submaps, submap.POINTS))
    fitted = learned.methods(learned.read(arguments.fits, registration.dimensions), how)
    models = trained.load_all(arguments.models, label, registration)
    covariances = method.tabulate([*fitted, *models], submaps)
    sections = {"predict": chosen, "label": label, "registration": registration}
    params = {section: parameters.as_metadata(values) for section, values in sections.items()}
    metadata = {"survey": arguments.survey, "params": params}
    artifacts.write_table(arguments.covariances, covariances, table.schema(registration.dimensions), metadata)


if __name__ == "__main__":
    parser = command.parser(__doc__)
    parser.add_argument("survey")
    parser.add_argument("--submaps", type=Path, required=True)
    parser.add_argument("--models", type=Path, nargs="+", required=True, help="trained ones; data/none is none")
    parser.add_argument("--fits", type=Path, required=True)
    parser.add_argument("--covariances", type=Path, required=True)
    command.run(main, parser)
