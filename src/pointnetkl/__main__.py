"""Inspect raw files, apply a trained model to submaps in files, and exchange pose graphs with other programs."""

import argparse
import importlib
import sys
from collections.abc import Sequence

from pointnetkl.commands import NAMES
from pointnetkl.workflow.errors import PointNetKLError


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command of an argument vector; return the exit status."""
    arguments = _parser().parse_args(argv)
    try:
        return int(arguments.run(arguments))
    except PointNetKLError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return 130  # what a shell gives for an interrupt


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m pointnetkl", description=__doc__)
    commands = parser.add_subparsers(title="commands", required=True)
    for name in NAMES:
        importlib.import_module(f"pointnetkl.commands.{name}").add(commands)
    return parser


if __name__ == "__main__":
    sys.exit(main())
