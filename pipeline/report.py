"""The paper's tables and figures beside ours, metrics.json, and one page that shows them all."""

import pointnetkl.workflow.blas  # noqa: F401 - before NumPy is loaded

# isort: split
import argparse
from pathlib import Path

from pointnetkl.reporting import model_card, page, report, results
from pointnetkl.reporting.results import Folders
from pointnetkl.workflow import artifacts, command, machine, parameters, study


def main(arguments: argparse.Namespace) -> None:
    """Read every stage's artifacts, write the report, print what matters most of it."""
    settings = parameters.read(arguments.params, "report", results.Settings)
    folders = Folders(arguments.data, arguments.models, arguments.reports, study.read(arguments.params))
    made = report.make(folders, settings)
    for name, content in {**made.files, **model_card.files(folders)}.items():
        artifacts.write_bytes(arguments.reports / name, content)
    artifacts.write_bytes(
        arguments.reports / page.THIS_MACHINE, page.this_machine(machine.in_words(machine.describe()))
    )
    print(*made.lines, sep="\n")
    print(f"The report: {arguments.reports / 'index.html'}")


if __name__ == "__main__":
    parser = command.parser(__doc__)
    parser.add_argument("--data", type=Path, required=True, help="what the stages made of the surveys")
    parser.add_argument("--models", type=Path, required=True, help="fits.json")
    parser.add_argument("--reports", type=Path, required=True, help="results; the report goes there too")
    command.run(main, parser)
