"""How one survey's labels depend on what the paper leaves open: runs, point spacing, noise; on a few submaps."""

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
    chosen = parameters.read(arguments.params, "vary", sensitivity.Settings)
    label = parameters.read(arguments.params, "label", monte_carlo.Settings)
    registration = parameters.read(arguments.params, "registration", gicp.Settings)
    cell_m = study.survey(arguments.params, arguments.survey).point_spacing_m
    numbers = choose(arguments.survey, arguments.submaps, chosen.submaps, registration)
    rows = functools.partial(
        sensitivity.rows,
        survey=arguments.survey,
        path=arguments.submaps.resolve(),  # a worker may stand elsewhere
        cell_m=cell_m,
        settings=chosen,
        label=label,
        registration=registration,
    )
    cases = sensitivity.cases(numbers, chosen, label)
    found = compute.over(rows, cases, f"vary {arguments.survey}", processes=label.engine != "cuda", unit="label")
    sections = {"vary": chosen, "label": label, "registration": registration}
    params = {name: parameters.as_metadata(values) for name, values in sections.items()}
    schema = label_table.variations_schema(registration.dimensions)
    variations = pd.DataFrame(chain.from_iterable(found), columns=schema.names)
    artifacts.write_table(arguments.variations, variations, schema, {"survey": arguments.survey, "params": params})


def choose(survey: str, path: Path, count: int, registration: gicp.Settings) -> list[int]:
    """Return the numbers of so many submaps, from flat to rugged."""
    submaps = list(submap.read_each(survey, path))
    ruggedness = functools.partial(sensitivity.ruggedness, registration=registration)
    rugged = compute.in_threads(ruggedness, submaps, f"choose of {survey}")
    return [submaps[place].number for place in sensitivity.spread(rugged, count)]


if __name__ == "__main__":
    parser = command.parser(__doc__)
    parser.add_argument("survey")
    parser.add_argument("--submaps", type=Path, required=True, help="points of the survey's submaps, Parquet")
    parser.add_argument("--variations", type=Path, required=True, help="labels to write, Parquet")
    command.run(main, parser)
