"""Command `demo`: a small drifted survey, made as raw files and corrected."""

import argparse
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pointnetkl.commands import shared
from pointnetkl.workflow import artifacts

if TYPE_CHECKING:
    import pandas as pd

    from pointnetkl import simulation
    from pointnetkl.correction.result import Corrected
    from pointnetkl.simulation import seabed, vehicle

_CRS, _CENTRE = "EPSG:32632", (647_000.0, 6_453_000.0)  # in the Skagerrak; nothing of the ground there is real
_SEED, _LARGEST_SEED = 1, 999_999_999
_DESCRIPTION = """\
Make a small survey whose navigation drifts, as raw files, and correct it. It needs no data and no set-up, and takes
less than a minute.

A simulated underwater vehicle sails eight lines of 1.5 km over basins and rock, 140 m deep, and once more the middle
one. Neighbouring swaths overlap by two fifths. Its gyrocompass and Doppler log let its position drift by some metres,
so that the lines disagree on the seabed. As it is simulated, the true track is known, and the demo says how far off the
recorded and the corrected track are.
"""
_EPILOG = f"""\
In FOLDER there will be:
  raw/        a Kongsberg .all file for each line, which other programs read as well
  truth.csv   the true track: x_m, y_m (easting and northing in {_CRS}), z_m (up) and yaw_rad (counter-clockwise
              from east) at the time of each ping, UTC seconds since 1970
  corrected/  what `correct` makes of raw/; begin with corrected/report.html

examples:
  python -m pointnetkl demo
  python -m pointnetkl demo --out /tmp/another --seed 7
  python -m pointnetkl inspect pointnetkl_demo/raw --plot

Another seed gives another seabed, drift and noise.
"""


def add(commands: Any) -> None:
    """Add the command's parser."""
    command = shared.parser(
        commands, "demo", "make a small drifted survey as raw files and correct it", _DESCRIPTION, _EPILOG
    )
    command.add_argument(
        "--out",
        type=Path,
        default=Path("pointnetkl_demo"),
        metavar="FOLDER",
        help="a new or empty folder (default: %(default)s)",
    )
    command.add_argument(
        "--seed", type=_seed, default=_SEED, metavar="N", help="of seabed, drift and noise (default: %(default)s)"
    )
    command.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Write the survey and its truth, correct it, and print the true errors before and after."""
    out, begin = arguments.out, time.monotonic()
    _require_empty(out)
    truth = write(out, arguments.seed)
    corrected = _correct(out / "raw", out / "corrected")
    print(corrected.verdict.sentence)
    print(_errors(corrected, truth))
    print(f"report: {out / 'corrected' / 'report.html'} (after {time.monotonic() - begin:.0f} s in all)")
    return 0


def write(out: Path, seed: int) -> "pd.DataFrame":
    """Write a survey as raw files and its true track below a folder; print and return the track.

    Raises:
        ArtifactError: a file cannot be written.
    """
    import pandas as pd  # these imports take a second, and --help does not need them

    from pointnetkl.simulation import kongsberg_files

    lines = _sail(seed)
    for number, line in enumerate(lines, start=1):
        kongsberg_files.write(out / "raw" / kongsberg_files.name(number, line), line, _CRS, number)
    truth = pd.concat([line.truth for line in lines], ignore_index=True)
    text = truth.to_csv(index=False, float_format="%.6f", lineterminator="\n")
    artifacts.write_bytes(out / "truth.csv", text.encode())
    print(f"raw files: {out / 'raw'} ({_summary(lines)})")
    print(f"true track: {out / 'truth.csv'} ({len(truth)} pings, {_CRS})", flush=True)
    return truth


def _correct(raw: Path, out: Path) -> "Corrected":
    """Correct raw files into a folder, as the command `correct` does where nothing is set."""
    from pointnetkl import correction

    return correction.correct(correction.Inputs([raw]), out, correction.Settings())


def _sail(seed: int) -> "list[simulation.Line]":
    from pointnetkl import simulation
    from pointnetkl.simulation import seabed

    settings, terrain = _settings(seed), _terrain()
    return list(simulation.survey(settings, _vehicle(), seabed.Random(terrain, seed, _CRS, _CENTRE)))


def _settings(seed: int) -> "simulation.Settings":
    from pointnetkl import simulation
    from pointnetkl.simulation import vehicle

    return simulation.Settings(
        seed=seed,
        vehicle="auv",
        grid="none",
        altitude_m=60.0,  # with the sector it makes the swath, 171 m
        ping_spacing_m=2.2,
        beam_spacing_m=2.2,
        layout=vehicle.Layout(
            lines=8,
            line_length_m=1500.0,
            line_spacing_m=100.0,
            start_jitter_m=20.0,
            repeat_m=1500.0,
            azimuth_deg=20.0,
        ),
    )


def _terrain() -> "seabed.Settings":
    """Return patchy ground: on most of it there is relief that a registration can hold on to."""
    from pointnetkl.simulation import seabed

    return seabed.Settings(
        depth_m=140.0,
        patch_m=350.0,
        relief=seabed.Relief(height_m=25.0, length_m=500.0, flat=0.4, stretch=6.0, azimuth_deg=60.0),
        hills=seabed.Field(slope=[0.02, 0.15], length_m=160.0),
        texture=seabed.Field(slope=[0.006, 0.04], length_m=24.0, octaves=3),
        outcrops=seabed.Outcrops(height_m=3.0, size_m=30.0, cover=0.06),
    )


def _vehicle() -> "vehicle.Settings":
    from pointnetkl.simulation import sonar, vehicle

    return vehicle.Settings(
        speed_mps=2.0,
        attitude=vehicle.Attitude(
            roll_deg=1.5, pitch_deg=1.5, yaw_deg=1.0, period_s=18.0, error_deg=0.005, wander_m=1.0
        ),
        navigation=vehicle.Navigation(
            scale_error=0.001, heading_error_deg=0.07, velocity_error_mps=0.004, correlation_s=300.0
        ),
        sonar=sonar.Settings(
            sector_deg=110.0,
            beams=512,
            noise_m=0.03,
            noise_growth=1.0,
            range_limit=3.0,
            dropouts=0.01,
            outliers=0.004,
            outlier_m=2.0,
            flagged=0.98,
        ),
    )


def _summary(lines: "Sequence[simulation.Line]") -> str:
    soundings = sum(len(line.raw) for line in lines)
    first, last = lines[0].truth["time_s"].iloc[0], lines[-1].truth["time_s"].iloc[-1]
    return f"{len(lines)} lines, {soundings:,} soundings, {(last - first) / 3600:.1f} hours of a simulated vehicle"


def _errors(corrected: "Corrected", truth: "pd.DataFrame") -> str:
    """Return the true errors of the pings in words: as they are, and of the track's shape alone."""
    from pointnetkl.slam.graph import trajectory_error

    time_s = truth["time_s"].to_numpy()
    # the nearest, because raw files round times to milliseconds
    ping = np.searchsorted((time_s[1:] + time_s[:-1]) / 2, corrected.track["time_s"])
    true = truth[["x_m", "y_m", "z_m"]].to_numpy()[ping]
    before = corrected.track[["x_m", "y_m", "z_m"]].to_numpy() + np.array([*corrected.origin, 0.0])
    after = before + corrected.track.assign(moved_z_m=0.0)[["moved_x_m", "moved_y_m", "moved_z_m"]].to_numpy()
    plain = [trajectory_error.rmse(places[:, :2], true[:, :2]) for places in (before, after)]
    fitted = [trajectory_error.align_se2(places, true) for places in (before, after)]
    shape = [trajectory_error.rmse(places[:, :2], true[:, :2]) for places in fitted]
    return (
        f"true error of position, rms of {len(ping)} pings: {_before_and_after(plain)}\n"
        "  without the shift and turn of the whole track, which its soundings cannot tell:"
        f" {_before_and_after(shape)}"
    )


def _before_and_after(errors_m: Sequence[float]) -> str:
    before, after = errors_m
    return f"{before:.2f} m before, {after:.2f} m after"


def _require_empty(out: Path) -> None:
    if out.exists() and not (out.is_dir() and not any(out.iterdir())):
        raise shared.CommandError(f"{out}: exists already and is not an empty folder; name another with --out")


def _seed(text: str) -> int:
    if not (text.isdecimal() and int(text) <= _LARGEST_SEED):
        raise argparse.ArgumentTypeError(f"{text!r} must be a whole number from 0 to {_LARGEST_SEED}")
    return int(text)
