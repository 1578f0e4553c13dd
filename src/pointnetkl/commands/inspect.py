"""Command `inspect`: describes raw files."""

import argparse
import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pointnetkl.commands import shared
from pointnetkl.workflow.errors import PointNetKLError

if TYPE_CHECKING:
    from pointnetkl import readers
    from pointnetkl.inspection.facts import Facts

_DESCRIPTION = """\
Describe raw files of bathymetry: format, sonar, time, pings, soundings, track, depths, place, and what the reader left
out and why. It needs no set-up: try it first on files of your own.

A file is read as a whole, by the readers of stage `ingest`, in little memory however large it is. Formats are
recognised by the content, else by the name:
  pings       Kongsberg .all, Kongsberg .kmall, GSF, XTF, generic pings (Parquet, CSV)
  points      LAS/LAZ, XYZ
  submaps     PCD with the pose in VIEWPOINT
  grids       GeoTIFF, BAG: to simulate surveys over
  navigation  SBET
In a folder every such file is described, and other files are ignored.
"""
_EPILOG = """\
examples:
  python -m pointnetkl inspect line_0012.all
  python -m pointnetkl inspect survey/ --plot survey_plots
  python -m pointnetkl inspect *.gsf --json > lines.json

A sounding is valid if neither the sonar nor its operator rejected it, and if its place and depth are possible. Depths
are positive below the level that `vertical` names. For pings the range of depths holds 98 % of the valid soundings,
because a single wrong one would otherwise set it; `depth_extremes_m` has the extremes. The JSON is a list with an
object for each file: null where there is no number, lengths in metres, times in UTC. `pings` is the number that could
be read, `pings_used` the number of those with a time and a place.

While a file is read, its soundings are kept on disk, 29 bytes each, in the folder for temporary files. If that folder
is small or in memory, set TMPDIR to another.

A file that cannot be used is reported on stderr and has an `error` in the JSON; the others are described, and the exit
status is 1. A file without pings, for example one of positions only, is no error: `pings` is 0, and `problems` says
what the file has.
"""


def add(commands: Any) -> None:
    """Add the command's parser."""
    command = shared.parser(commands, "inspect", "describe raw files of bathymetry", _DESCRIPTION, _EPILOG)
    command.add_argument("files", type=Path, nargs="*", metavar="FILE", help="raw files, or folders of them")
    command.add_argument("--json", action="store_true", help="print a JSON list with an object for each file")
    command.add_argument(
        "--plot",
        type=Path,
        nargs="?",
        const=Path(),
        metavar="FOLDER",
        help="save a map and a view of the swaths of each file there, as NAME_map.png and NAME_swath.png"
        " (default: the current folder)",
    )
    command.add_argument(
        "--zone",
        default="auto",
        metavar="EPSG:CODE",
        help="CRS for the map of longitudes and latitudes (default: the UTM zone of the first position)",
    )
    command.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Describe each file; return 1 if one of them cannot be used."""
    # these imports take a second, and --help does not need them
    from pointnetkl.inspection import choice, text

    paths, folder = _paths(arguments)
    settings = _settings(arguments.zone)
    files, every = choice.files(paths), []
    names = choice.names(files)
    for file in files:
        facts = _facts(file, settings, folder, names[file])
        if not arguments.json and facts.pings is not None:
            print(text.block(facts) + "\n", flush=True)
        if facts.error is not None:
            print(f"error: {facts.error}", file=sys.stderr)
        every.append(facts)
    if arguments.json:
        print(json.dumps([facts.as_json() for facts in every], indent=2, allow_nan=False))
    elif len(every) > 1:
        print(text.total(every))
    return int(any(facts.error is not None for facts in every))


def _paths(arguments: argparse.Namespace) -> tuple[list[Path], Path | None]:
    """Return the files to describe, and the folder for plots; argparse takes FILE in `--plot FILE` for the folder."""
    files, folder = arguments.files, arguments.plot
    if folder is not None and (folder.is_file() or not files) and folder != Path():
        files, folder = [folder, *files], Path()
    if not files:
        raise shared.CommandError("no file is given; see the examples of `inspect --help`")
    return files, folder


def _settings(zone: str) -> "readers.Settings":
    from pointnetkl import readers

    try:
        return readers.Settings(utm_zone=zone)
    except ValueError as error:
        raise shared.CommandError(f"--zone: {error}") from error


def _facts(file: Path, settings: "readers.Settings", folder: Path | None, name: str) -> "Facts":
    from pointnetkl.inspection import choice
    from pointnetkl.inspection.facts import Facts

    try:
        inspected = choice.inspect(file, settings)
        if folder is None:
            return inspected.facts
        from pointnetkl.inspection import plots  # matplotlib takes a second to import

        return plots.save(inspected, folder, name)
    except PointNetKLError as error:
        return Facts(str(file), format=choice.format_name(file), error=str(error))
