"""Command lines of the stages: the option --params, and errors as one sentence with a non-zero exit status."""

import argparse
import sys
from collections.abc import Callable
from pathlib import Path

from pointnetkl.workflow.errors import PointNetKLError


def parser(description: str) -> argparse.ArgumentParser:
    """Return a parser with the option that every stage has: the parameter file to read."""
    arguments = argparse.ArgumentParser(description=description, formatter_class=argparse.ArgumentDefaultsHelpFormatter)
    arguments.add_argument("--params", type=Path, default=Path("params.yaml"), help="parameter file")
    return arguments


def run(main: Callable[[argparse.Namespace], None], arguments: argparse.ArgumentParser) -> None:
    """Parse the command line and run `main`; a PointNetKLError becomes one sentence and exit status 1."""
    try:
        main(arguments.parse_args())
    except PointNetKLError as error:
        sys.exit(f"error: {error}")
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        sys.exit(130)  # as a shell counts it
