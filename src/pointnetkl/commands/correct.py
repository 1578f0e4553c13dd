"""Command `correct`: raw lines in, a track and a map that agree with themselves out."""

import argparse
import dataclasses
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pointnetkl.commands import shared

if TYPE_CHECKING:
    from pointnetkl.correction import Corrected, Settings

_DESCRIPTION = """\
Correct the navigation of a survey by its own overlaps: raw lines in, a track and a map that agree with themselves out.

The survey is cut into submaps. Where one returns to ground that is mapped already it is registered to it (MAP), and its
covariance says how much the ground there can tell. All closures together with the drift of navigation give a correction
at every ping, with its sigma. Then closures are left out in turn: where the others do not predict them better than
navigation does, or overlapping passes disagree more than before, the track is left as it was, and the report says so.

Give raw files or folders of any format that `inspect` reads (an SBET file in the folder replaces their navigation), the
folder of an ingested survey (data/surveys/NAME), or posed PCD submaps in the order of the track.
"""
_EPILOG = """\
drift of navigation (--drift):
  navigation_grade   ring laser or fibre optic gyros of 0.003 deg/h with a Doppler log: 0.1 to 0.2 % of the distance
  gyrocompass        fibre optic gyrocompass with a Doppler log: 0.3 % of the distance
  compass            micromechanical unit with a magnetic compass: 1 to 2 % of the distance
  gnss, usbl         absolute positions that wander by 0.5 m and 3 m
  NAME=NUMBER,...    rates: scale_error (a share), heading_bias_deg, heading_walk_deg, heading_correlation_s,
                     velocity_walk_mps, velocity_correlation_s, position_walk_m, position_correlation_s
Without it the preset of --navigation is taken, and multiplied by what the closures say of it.

examples:
  python -m pointnetkl correct survey/ --out corrected
  python -m pointnetkl correct survey/ --out corrected --navigation gnss
  python -m pointnetkl correct lines/*.all --out corrected --drift scale_error=0.004,heading_bias_deg=0.3
  python -m pointnetkl correct survey/ --out corrected --reference chart.bag --fixes usbl.csv

OUT gets report.html (look there first), track.csv, maps, soundings, navigation for other programs and the closures:
docs/formats.md describes each. A run that is killed goes on where it was when the same command is given again; what it
has finished is kept in .OUT.partial beside OUT.
"""


def add(commands: Any) -> None:
    """Add the command's parser."""
    command = shared.parser(commands, "correct", "correct a survey by its own overlaps", _DESCRIPTION, _EPILOG)
    command.add_argument("survey", type=Path, nargs="+", metavar="SURVEY", help="raw files, or folders of them")
    command.add_argument("--out", type=Path, required=True, metavar="OUT", help="folder to make")
    command.add_argument("--replace", action="store_true", help="replace OUT if it is there")
    command.add_argument(
        "--navigation",
        choices=("dead-reckoning", "gnss", "usbl"),
        help="what positions are: they drift, or they are absolute and wander (default: gnss beside an SBET or with a"
        " sonar less than 8 m deep, else dead-reckoning)",
    )
    command.add_argument("--drift", metavar="RATES", help="how navigation drifts: see below (default: measured)")
    command.add_argument("--length", type=float, metavar="M", help="of a submap, metres (default: from the swath)")
    command.add_argument("--spacing", type=float, metavar="M", help="of a submap's points (default: from the pings)")
    command.add_argument("--cell", type=float, metavar="M", help="of the maps (default: about five soundings a cell)")
    command.add_argument("--held", nargs="+", default=[], metavar="FILE", help="raw files whose navigation is right")
    command.add_argument(
        "--fixes", type=Path, metavar="CSV", help="absolute positions: time_s, sigma_m, lon_deg, lat_deg or x_m, y_m"
    )
    command.add_argument("--reference", type=Path, metavar="GRID", help="a known seabed, GeoTIFF or BAG, same CRS")
    command.add_argument(
        "--ties", type=Path, metavar="LIST", help="ties set by hand, as mbnavadjust has them: TIE, COV, GLOBALTIE"
    )
    command.add_argument("--zone", metavar="EPSG:CODE", help="CRS of the map (default: UTM zone of the first position)")
    command.add_argument(
        "--params", type=Path, metavar="YAML", help="parameters, whose section `correct` is read (default: none)"
    )
    command.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Correct the survey, and print the verdict and where the report is."""
    from pointnetkl import correction

    begin = time.monotonic()
    source = correction.Inputs(
        arguments.survey,
        held=[Path(name).name for name in arguments.held],
        fixes=arguments.fixes,
        reference=arguments.reference,
        ties=arguments.ties,
        rates=_stated(arguments.params),
    )
    corrected = correction.correct(source, arguments.out, _settings(arguments), arguments.replace)
    print(summary(corrected, arguments.out))
    print(f"{time.monotonic() - begin:.0f} s", file=sys.stderr)
    return 0


def summary(corrected: "Corrected", out: Path) -> str:
    """Return the verdict and where the report is, as lines of text."""
    verdict = corrected.verdict
    lines = ["", verdict.sentence]
    if verdict.drift:
        measured = "drift of navigation" if verdict.accepted else "assumed drift of navigation"
        lines.append(f"{measured}: {verdict.drift}")
    if verdict.applied:
        lines.append(f"the track moved by {corrected.rms_moved_m:.3g} m (rms)")
    return "\n".join([*lines, f"report: {out / 'report.html'}"])


def _settings(arguments: argparse.Namespace) -> "Settings":
    from pointnetkl import correction
    from pointnetkl.workflow import parameters

    base = (
        parameters.read(arguments.params, "correct", correction.Settings) if arguments.params else correction.Settings()
    )
    asked = {
        "navigation": arguments.navigation,
        "drift": arguments.drift,
        "submap_length_m": arguments.length,
        "point_spacing_m": arguments.spacing,
        "cell_m": arguments.cell,
        "utm_zone": arguments.zone,
    }
    try:
        return dataclasses.replace(base, **{name: value for name, value in asked.items() if value is not None})
    except ValueError as error:
        raise shared.CommandError(str(error)) from error


def _stated(params: Path | None) -> dict[str, Any]:
    from pointnetkl.slam.closing import drift
    from pointnetkl.workflow import parameters

    has_rates = params is not None and "navigation" in parameters.sections(params)
    return parameters.read(params, "navigation", dict[str, drift.Settings]) if params and has_rates else {}
