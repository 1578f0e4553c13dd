"""Vary the labels of a few submaps of one survey: by number of runs, point spacing and noise of the copy."""

import pointnetkl.workflow.blas  # noqa: F401 - before NumPy is loaded

# isort: split
import argparse
import functools
from itertools import chain
from pathlib import Path

import pandas as pd

from pointnetkl.labels import sensitivity
from pointnetkl.registration import gicp, monte_carlo
from pointnetkl.registration.covariance import label_table
from pointnetkl.surveys import submap
from pointnetkl.workflow import artifacts, command, compute, parameters, study


def main(arguments: argparse.Namespace) -> None:
    """Choose submaps from flat to rugged and write their labels under every condition."""
    settings = parameters.read(arguments.params, "vary", sensitivity.Settings)
    label = parameters.read(arguments.params, "label", monte_carlo.Settings)
    registration = parameters.read(arguments.params, "registration", gicp.Settings)
    artifacts.require_survey(arguments.survey, arguments.submaps)
    numbers = choose(arguments.survey, arguments.submaps, settings.submaps, registration)
    rows = functools.partial(
        sensitivity.rows,
        survey=arguments.survey,
        path=arguments.submaps.resolve(),  # workers may have another current folder
        cell_m=study.survey(arguments.params, arguments.survey).point_spacing_m,
        settings=settings,
        label=label,
        registration=registration,
    )
    variations = sensitivity.variations(numbers, settings, label)
    labels = compute.over(rows, variations, f"vary {arguments.survey}", processes=label.engine != "cuda", unit="label")
    sections = {"vary": settings, "label": label, "registration": registration}
    params = {name: parameters.as_metadata(values) for name, values in sections.items()}
    schema = label_table.variations_schema(registration.dimensions)
    table = pd.DataFrame(chain.from_iterable(labels), columns=schema.names)
    artifacts.write_table(arguments.variations, table, schema, {"survey": arguments.survey, "params": params})


def choose(survey: str, path: Path, count: int, registration: gicp.Settings) -> list[int]:
    """Return the numbers of `count` submaps, from flat to rugged."""
    submaps = list(submap.stream(survey, path))
    ruggedness = functools.partial(sensitivity.ruggedness, registration=registration)
    ruggednesses = compute.in_threads(ruggedness, submaps, f"choose of {survey}")
    return [submaps[index].number for index in sensitivity.spread(ruggednesses, count)]


if __name__ == "__main__":
    parser = command.parser(__doc__)
    parser.add_argument("survey", help="the survey's name in study.surveys")
    parser.add_argument("--submaps", type=Path, required=True, help="points of the survey's submaps, Parquet")
    parser.add_argument("--variations", type=Path, required=True, help="labels to write, Parquet")
    command.run(main, parser)
