"""Command `inspect`: what raw files hold."""

import argparse
import json
import sys
from pathlib import Path
from typing import Any

from pointnetkl.commands import shared
from pointnetkl.workflow.errors import PointNetKLError

_DESCRIPTION = """\
What raw files of bathymetry hold: format, sonar, time, pings, soundings, track, depths, place, and what was left out
and why. Nothing needs to be set up for it: it is the first thing to try on files of your own.

A file is read whole, by the readers of stage `ingest`, in little memory however large it is. Formats are known by the
content, then by the name:
  pings       Kongsberg .all, Kongsberg .kmall, GSF, XTF, generic pings (Parquet, CSV)
  points      LAS/LAZ, XYZ
  submaps     PCD with the pose in VIEWPOINT
  grids       GeoTIFF, BAG: to simulate surveys over
  navigation  SBET
Of a folder every such file is told, and what else stands in it is passed over.
"""
_EPILOG = """\
examples:
  python -m pointnetkl inspect line_0012.all
  python -m pointnetkl inspect survey/ --plot survey_plots
  python -m pointnetkl inspect *.gsf --json > lines.json

A valid sounding is one that neither the sonar nor its operator rejected, and that has a place and a depth that can be.
Depths are positive below what `vertical` says; of pings the range is that of 98 % of the valid soundings, because a
single wrong one would set it otherwise (`depth_extremes_m` has all). JSON is a list with an object for each file; null
stands where there is no number, lengths are metres, times UTC. `pings` could be read, `pings_used` of them have a time
and a place.

While a file is read its soundings stand on disk, 29 bytes each, in the folder for temporary files: where that is
small, or memory, let TMPDIR name another.

A file that cannot be used is named on stderr, and has an `error` in the JSON; the others are told, and the exit status
is 1. A file without pings, as one of positions only, is no error: `pings` is 0, and `problems` says what was found.
"""


def add(commands: Any) -> None:
    """Add the command's words."""
    command = shared.parser(commands, "inspect", "what raw files of bathymetry hold", _DESCRIPTION, _EPILOG)
    command.add_argument("files", type=Path, nargs="*", metavar="FILE", help="raw files, or folders of them")
    command.add_argument("--json", action="store_true", help="a JSON list with an object for each file")
    command.add_argument(
        "--plot",
        type=Path,
        nargs="?",
        const=Path(),
        metavar="FOLDER",
        help="save a map and a view of the swaths of each file there, as NAME_map.png and NAME_swath.png"
        " (default: where you are)",
    )
    command.add_argument(
        "--zone",
        default="auto",
        metavar="EPSG:CODE",
        help="CRS for the map of longitudes and latitudes (default: the UTM zone of the first position)",
    )
    command.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Tell of each file; return 1 if one of them cannot be used."""
    # about a second, which --help need not take
    from pointnetkl.inspection import choice, text

    paths, folder = _given(arguments)
    how = _settings(arguments.zone)
    files, told = choice.files(paths), []
    names = choice.names(files)
    for file in files:
        facts = _facts(file, how, folder, names[file])
        if not arguments.json and facts.pings is not None:
            print(text.block(facts) + "\n", flush=True)
        if facts.error is not None:
            print(f"error: {facts.error}", file=sys.stderr)
        told.append(facts)
    if arguments.json:
        print(json.dumps([facts.as_json() for facts in told], indent=2, allow_nan=False))
    elif len(told) > 1:
        print(text.total(told))
    return int(any(facts.error is not None for facts in told))


def _given(arguments: argparse.Namespace) -> tuple[list[Path], Path | None]:
    """Return the files to tell of, and the folder for plots; `--plot FILE` has the file for a folder."""
    files, folder = arguments.files, arguments.plot
    if folder is not None and (folder.is_file() or not files) and folder != Path():
        files, folder = [folder, *files], Path()
    if not files:
        raise shared.CommandError("no file is given; `inspect --help` has examples")
    return files, folder


def _settings(zone: str) -> Any:
    from pointnetkl import readers

    try:
        return readers.Settings(seed=0, utm_zone=zone)
    except ValueError as error:
        raise shared.CommandError(f"--zone: {error}") from error


def _facts(file: Path, how: Any, folder: Path | None, name: str) -> Any:
    from pointnetkl.inspection import choice
    from pointnetkl.inspection.facts import Facts

    try:
        found = choice.look(file, how)
        if folder is None:
            return found.facts
        from pointnetkl.inspection import plots  # matplotlib: a second

        return plots.save(found, folder, name)
    except PointNetKLError as error:
        return Facts(str(file), format=choice.format_name(file), error=str(error))
