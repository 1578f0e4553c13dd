"""Small raw surveys: parallel lines to and fro over a known seabed, as generic Parquet files, navigated with drift."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from pyproj import Proj

import generic_files
import sbet_files
import terrains
from pointnetkl.correction.solution.belief import Navigation
from pointnetkl.slam.closing import drift
from pointnetkl.surveys import survey

CRS, EAST, NORTH = "EPSG:32633", 600_000.0, 6_000_000.0
BEGIN_S, SPEED_MPS, TURN_S = 1_500_000_000.0, 2.0, 120.0
DEPTH_M, DOWN_M = 20.0, 40.0  # of the vehicle, and of the seabed below it
_GPS_EPOCH_S, _LEAP_S, _WEEK_S = 315_964_800, 18, 604_800.0  # SBET counts seconds of the GPS week; leaps of 2017

Seabed = Callable[[np.ndarray, np.ndarray], np.ndarray]


def hills(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return the height of hills some 80 m long and metres high, metres."""
    places = np.column_stack([np.ravel(x), np.ravel(y)]) / 4
    return np.asarray(-DEPTH_M - DOWN_M + 4 * terrains.height("mild", places)).reshape(np.shape(x))


def flat(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return the height of a plane, metres."""
    return np.full(np.shape(x), -DEPTH_M - DOWN_M)


@dataclass(frozen=True)
class Plan:
    """What is sailed, and how it is navigated."""

    lines: int = 4
    line_m: float = 360.0
    apart_m: float = 40.0
    step_m: float = 2.5  # from ping to ping
    beams: int = 36
    swath_m: float = 80.0
    noise_m: float = 0.05  # of soundings
    seabed: Seabed = hills
    drift_m: float = 0.0  # of navigation: it begins at zero and grows by about this from line to line
    returns: bool = False  # the drift is gone on the last line
    depth_m: float = DEPTH_M
    heads: int = 1  # two share the beams, ping at one time, and have a file each
    jitter_m: float = 0.0  # of positions, from ping to ping
    on_earth: bool = False  # positions are longitudes and latitudes
    shift_m: tuple[float, float] = (0.0, 0.0)  # of all positions, constant
    seed: int = 0


@dataclass(frozen=True)
class Raw:
    """Raw files of a plan, one a line, and where the vehicle truly was."""

    folder: Path
    files: list[Path]
    truth: pd.DataFrame  # time_s, x_m and y_m (easting, northing) of all pings

    def error(self, track: pd.DataFrame, origin: tuple[float, float], share: float) -> np.ndarray:
        """Return errors (n, 2) of a track's pings with a share of its correction, metres."""
        return np.column_stack(
            [
                track[f"{axis}_m"]
                + offset
                + share * track[f"moved_{axis}_m"]
                - np.interp(track["time_s"], self.truth["time_s"], self.truth[f"{axis}_m"])
                for axis, offset in zip("xy", origin, strict=True)
            ]
        )


def write(folder: Path, plan: Plan, crs: str = CRS) -> Raw:
    """Write a plan's lines as files of a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    files, truths, rng = [], [], np.random.default_rng(plan.seed)
    for line in range(plan.lines):
        table, truth = _line(plan, line, rng)
        table = _geographic(table) if plan.on_earth else table
        for head in range(plan.heads):
            part = table[table["beam"] * plan.heads // plan.beams == head]
            name = f"line_{line}.parquet" if plan.heads == 1 else f"line_{line}_head_{head}.parquet"
            files.append(generic_files.parquet(folder / name, part, None if plan.on_earth else crs))
        truths.append(truth)
    return Raw(folder, files, pd.concat(truths, ignore_index=True))


def at_once(folder: Path, plan: Plan) -> Raw:
    """Write a plan's lines as if vehicles had sailed them at the same time."""
    raw = write(folder, plan)
    for file in raw.files[1:]:
        table = pd.read_parquet(file)
        generic_files.parquet(file, table.assign(time_s=table["time_s"] - table["time_s"].min() + BEGIN_S), CRS)
    return raw


def grid(path: Path, plan: Plan, crs: str = CRS, cell_m: float = 2.0, margin_m: float = 60.0) -> Path:
    """Write the plan's true seabed as a GeoTIFF of heights."""
    import rasterio
    from rasterio.transform import from_origin

    west, north = -margin_m, plan.apart_m * (plan.lines - 1) + plan.swath_m / 2 + margin_m
    columns = int((plan.line_m + 2 * margin_m) / cell_m)
    rows = int((north + plan.swath_m / 2 + margin_m) / cell_m)
    x = west + cell_m * (np.arange(columns) + 0.5)
    y = north - cell_m * (np.arange(rows) + 0.5)
    z = plan.seabed(*np.meshgrid(x, y)).astype("float32")
    profile = {"height": rows, "width": columns, "count": 1, "dtype": "float32", "nodata": -9999.0, "crs": crs}
    transform = from_origin(EAST + west, NORTH + north, cell_m, cell_m)
    with rasterio.open(path, "w", driver="GTiff", transform=transform, **profile) as dataset:
        dataset.write(z, 1)
    return path


def sbet(path: Path, raw: Raw) -> Path:
    """Write the true track of a survey as SBET, two records a second."""
    time = np.arange(raw.truth["time_s"].iloc[0] - 2, raw.truth["time_s"].iloc[-1] + 2, 0.5)
    x, y = (np.interp(time, raw.truth["time_s"], raw.truth[name]) for name in ("x_m", "y_m"))
    longitude, latitude, convergence = _on_earth(x, y)
    eastward = np.interp(time, raw.truth["time_s"], np.gradient(raw.truth["x_m"])) >= 0
    records = np.zeros((len(time), 17))
    records[:, 0] = (time + _LEAP_S - _GPS_EPOCH_S) % _WEEK_S
    records[:, 1:3] = np.deg2rad(np.column_stack([latitude, longitude]))
    records[:, 9] = np.where(eastward, np.pi / 2, -np.pi / 2) + convergence
    return sbet_files.write(path, records)


def smrmsg(path: Path, position_m: float, heading_arcmin: float, records: int = 50) -> Path:
    """Write an accuracy as SMRMSG: north and east as sure as each other, down half as sure."""
    table = np.zeros((records, 10))
    table[:, 0] = np.arange(records)
    table[:, 1:4] = position_m, position_m, 2 * position_m
    table[:, 4:7], table[:, 7:9], table[:, 9] = 0.01, 0.5, heading_arcmin
    path.write_bytes(table.astype("<f8").tobytes())
    return path


def pings(lines: int = 4, line_m: float = 400.0, apart_m: float = 40.0, step_m: float = 2.0) -> pd.DataFrame:
    """Return the pings (survey.PINGS) of lines to and fro as navigation has them, without files."""
    plan = Plan(lines=lines, line_m=line_m, apart_m=apart_m, step_m=step_m, beams=1)
    parts = [_line(plan, line, np.random.default_rng(0))[0].assign(file=f"line_{line}.all") for line in range(lines)]
    table = pd.concat(parts, ignore_index=True)
    table = table.assign(x_m=table["x_m"] - EAST, y_m=table["y_m"] - NORTH, z_m=-table["depth_m"])
    table = table.assign(
        yaw_rad=np.unwrap(np.pi / 2 - table["heading_rad"]), ping=np.arange(len(table), dtype=np.int32)
    )
    return table[survey.PINGS.names]


def navigation(pings: pd.DataFrame, name: str = "gyrocompass", every: int = 30) -> Navigation:
    """Return the navigation of submaps of so many pings each, that drifts as a preset says."""
    lines = [rows.to_numpy() for _, rows in pings.groupby("file", sort=False)["ping"]]
    middles = np.concatenate([rows[every // 2 :: every] for rows in lines])
    first, rates = pings.iloc[0], drift.PRESETS[name]
    fix = drift.Fix(*(float(first[key]) for key in ("time_s", "x_m", "y_m")))
    poses = pings[["x_m", "y_m", "yaw_rad"]].to_numpy()[middles]
    return Navigation(pings["time_s"].to_numpy()[middles], poses, rates, None if rates.position_walk_m else fix)


def shifted(plan: Plan, east_m: float, north_m: float) -> Plan:
    """Return a plan all of whose positions are off by the same."""
    return replace(plan, shift_m=(east_m, north_m))


def _line(plan: Plan, line: int, rng: np.random.Generator) -> tuple[pd.DataFrame, pd.DataFrame]:
    along = np.arange(0.0, plan.line_m + plan.step_m / 2, plan.step_m)
    back = line % 2 == 1
    x, y = (plan.line_m - along if back else along), np.full(len(along), plan.apart_m * line)
    heading = np.full(len(along), np.pi / 2 if not back else 3 * np.pi / 2)
    time = BEGIN_S + along / SPEED_MPS + line * (plan.line_m / SPEED_MPS + TURN_S)
    across = np.tile(np.linspace(-plan.swath_m / 2, plan.swath_m / 2, plan.beams), len(along))
    ping = np.repeat(np.arange(len(along)), plan.beams)
    # to starboard of east is south
    sounded = x[ping], y[ping] - across * np.sin(heading[ping])
    z = plan.seabed(*sounded) + plan.noise_m * rng.standard_normal(len(ping))
    east, north = _drift(plan, time) + plan.jitter_m * rng.standard_normal((2, len(along)))
    table = pd.DataFrame(
        {
            "time_s": time[ping],
            "x_m": (EAST + x + plan.shift_m[0] + east)[ping],
            "y_m": (NORTH + y + plan.shift_m[1] + north)[ping],
            "depth_m": plan.depth_m,
            "heading_rad": heading[ping],
            "roll_rad": 0.0,
            "pitch_rad": 0.0,
            "beam": np.tile(np.arange(plan.beams), len(along)),
            "along_m": 0.0,
            "across_m": across,
            "down_m": -z - plan.depth_m,
            "quality": 0,
        }
    )
    return table, pd.DataFrame({"time_s": time, "x_m": EAST + x, "y_m": NORTH + y})


def _geographic(table: pd.DataFrame) -> pd.DataFrame:
    longitude, latitude, convergence = _on_earth(table["x_m"], table["y_m"])
    heading = np.mod(table["heading_rad"] + convergence, 2 * np.pi)
    places = {"longitude_deg": longitude, "latitude_deg": latitude, "heading_rad": heading}
    return table.drop(columns=["x_m", "y_m"]).assign(**places)


def _on_earth(x: Any, y: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return longitudes, latitudes (degrees), and the heading (n,) of grid north from true north, radians."""
    map_ = Proj(CRS)
    longitude, latitude = map_(np.asarray(x), np.asarray(y), inverse=True)
    return longitude, latitude, np.deg2rad(map_.get_factors(longitude, latitude).meridian_convergence)


def _drift(plan: Plan, time_s: np.ndarray) -> np.ndarray:
    """Return errors (2, n) of navigation that begin at zero, grow and bend as those of a Doppler log do."""
    leg_s = plan.line_m / SPEED_MPS + TURN_S
    legs = (time_s - BEGIN_S) / leg_s
    if plan.returns:
        run = np.clip((legs - 0.5) / (plan.lines - 1.5), 0.0, 1.0)  # from the end of the first line to the last's begin
        return plan.drift_m * np.array([1.0, -0.7])[:, None] * np.sin(np.pi * run) ** 2
    return plan.drift_m * np.array([legs + 0.3 * np.sin(2 * legs), -0.7 * legs + 0.5 * (1 - np.cos(1.5 * legs))])
