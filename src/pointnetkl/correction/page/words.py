"""What the page says in words: what states and files mean, and what figures show to who cannot see them."""

from collections.abc import Sequence
from datetime import UTC, datetime
from fnmatch import fnmatch
from pathlib import Path

import numpy as np

from pointnetkl.correction.page import numbers
from pointnetkl.correction.page.numbers import Curves
from pointnetkl.correction.page.rasters import Raster
from pointnetkl.correction.result import Corrected, Verdict
from pointnetkl.slam.closing.schemas import State
from pointnetkl.surveys.survey import POINTS, SUBMAPS, SWATHS

# names in `facts` that the page knows: lists of sentences; the parameters as YAML; arrays (k,) of how much two passes
# differ in the cells that they share, metres
PROBLEMS, LEFT_OUT, PARAMETERS = "problems", "products left out", "parameters"
DISAGREEMENT = ("disagreement_before_m", "disagreement_after_m")

STATES = {
    State.ACCEPTED: ("accepted", "It is used."),
    State.UNMATCHED: (
        "no match",
        "Too few of the submap's soundings lie over the ground mapped before, or the match has no covariance.",
    ),
    State.FLAT: ("flat ground", "The ground holds the submap in no direction, so the closure says nothing."),
    State.RESIDUALS: ("poor fit", "Its soundings fit the ground worse than those of the survey's other closures."),
    State.PREDICTION: (
        "contradiction",
        "It contradicts navigation and the other closures, even were the drift several times as large as assumed.",
    ),
    State.OUTVOTED: ("outvoted", "The other closures together agree on another place, and it was left out."),
}
_PRODUCTS = (
    ("map_before.tif", "Depth, density and uncertainty as navigated (GeoTIFF)"),
    ("map_after.tif", "The same after the correction"),
    ("difference.tif", "The map after less the map before, metres"),
    ("track.csv", "A row per ping: time, place, depth, heading, correction and sigmas"),
    ("soundings.laz", "Soundings after the correction, with flags"),
    ("soundings.parquet", "The same as a table"),
    ("closures.csv", "A row per loop closure: where, overlap, shift, V, residual, and accepted or why not"),
    ("parameters.yaml", "All parameters of this correction"),
    ("*.gpkg", "Lines before and after, for a GIS (GeoPackage)"),
    ("*.tum", "Corrected trajectory: seconds, place, quaternion (TUM)"),
    ("*.g2o", "The graph that was solved: submaps, drift and closures (g2o)"),
    ("*cov*.txt", "Corrected poses, each with its 6 x 6 covariance"),
    ("*.na0", "Navigation by raw file, for MB-System (mbprocess)"),
    ("*.fnv", "Corrected navigation for MB-System"),
    ("*tie*", "Closures as ties, for mbnavadjust"),
    ("*smrmsg*", "Accuracy beside the SBET"),
    ("*sbet*", "Corrected track (SBET)"),
)
_MOST_LINKS = 3  # of files of one kind


def products(folder: Path) -> list[tuple[list[tuple[str, str]], int, str]]:
    """Return the kinds of files in the folder: names and addresses of some, how many more there are, and what they are.

    Files that the page does not know are left out: of them it has nothing to say.
    """
    files = sorted(path for path in folder.rglob("*") if path.is_file() and not path.name.startswith("."))
    kinds: dict[str, list[Path]] = {}
    for path in files:
        if words := next((words for pattern, words in _PRODUCTS if fnmatch(path.name.lower(), pattern)), None):
            kinds.setdefault(words, []).append(path.relative_to(folder))
    order = [words for _, words in _PRODUCTS if words in kinds]
    return [(_links(kinds[words]), max(0, len(kinds[words]) - _MOST_LINKS), words) for words in order]


def _links(paths: Sequence[Path]) -> list[tuple[str, str]]:
    from urllib.parse import quote

    return [(path.as_posix(), quote(path.as_posix())) for path in paths[:_MOST_LINKS]]


def survey_line(corrected: Corrected) -> str:
    """Return when, where and what the survey is, in a line of small print."""
    track, submaps = corrected.track, corrected.submaps
    parts = []
    if has_times(corrected):
        first, last = utc(track["time_s"].min()), utc(track["time_s"].max())
        parts.append(f"{first[:16]} to {last[11:16] if first[:10] == last[:10] else last[:16]} UTC")
    if corrected.kind == SWATHS and len(track):
        parts.append(f"{len(track):,} pings".replace(",", " "))
    if submaps is not None:
        lines = len(np.unique(submaps.line))
        parts.append(f"{len(submaps.number)} submaps on {lines} line{'s' if lines != 1 else ''}")
    if corrected.kind == POINTS:
        parts.append("points without a track")
    parts.append("local coordinates" if corrected.crs == "local" else corrected.crs)
    return " · ".join(parts)


def has_times(corrected: Corrected) -> bool:
    """Return whether the track's times are true: those of another program's submaps only count."""
    time = corrected.track["time_s"].to_numpy(np.float64)
    return corrected.kind not in (SUBMAPS, POINTS) and len(time) > 1 and bool(np.isfinite(time).all() and np.ptp(time))


def utc(seconds: float) -> str:
    """Return a time, seconds since 1970, to the second."""
    return datetime.fromtimestamp(seconds, UTC).strftime("%Y-%m-%d %H:%M:%S")


def seabed_alt(raster: Raster, when: str, track: bool) -> str:
    """Return what a map of depths shows."""
    wide, high = raster.corners[1] - raster.corners[0]
    least, most = np.nanpercentile(raster.values, [1, 99])
    drawn = ", with the track drawn on it" if track else ""
    return (
        f"Hillshaded map of the seabed {when}{drawn}: {numbers.length(wide)} m from west to east,"
        f" {numbers.length(high)} m from south to north, depths {numbers.length(least)} to {numbers.length(most)} m."
    )


def shift_alt(corrected: Corrected) -> str:
    """Return what the three time series show."""
    track = corrected.track
    parts = []
    for name, column, variance in (("east", "moved_x_m", "var_xx_m2"), ("north", "moved_y_m", "var_yy_m2")):
        low, high = numbers.length(track[column].min()), numbers.length(track[column].max())
        sigma = numbers.length(float(np.sqrt(track[variance].median())))
        parts.append(f"{name} from {low} to {high} m, 1 sigma {sigma} m")
    turn = -np.degrees(track["moved_yaw_rad"])
    sigma = numbers.plain(float(np.degrees(np.sqrt(track["var_yaw_rad2"].median()))))
    parts.append(f"heading from {turn.min():.2f}° to {turn.max():.2f}°, 1 sigma {sigma}°".replace("-", "−"))
    return f"Correction along the track: {'; '.join(parts)} (median)."


def closures_alt(corrected: Corrected) -> str:
    """Return what the map of closures shows."""
    counts = numbers.by_state(corrected.closures)
    parts = [f"{count} {STATES[state][0]}" for state, count in counts.items()]
    return f"Map of {len(corrected.closures)} loop closures on the hillshaded seabed: {', '.join(parts)}."


def difference_alt(raster: Raster) -> str:
    """Return what the map of differences shows."""
    values = raster.values[np.isfinite(raster.values)]
    return (
        f"Map of the depth after less the depth before: rms {numbers.length(numbers.rms(values))} m,"
        f" 95 % of the area within {numbers.length(float(np.percentile(np.abs(values), 95)))} m."
    )


def agreement_alt(curves: Sequence[Curves], after: str) -> str:
    """Return what the curves of cells and closures show."""
    parts = [
        f"{each.label}: half of {len(each.after)} {each.of} at most {_median(each.before)} at navigation,"
        f" {_median(each.after)} {after}"
        for each in curves
    ]
    return f"Cumulative shares. {'; '.join(parts)}."


def _median(values: np.ndarray) -> str:
    return numbers.length(float(np.median(values)))


def chances(verdict: Verdict) -> list[str]:
    """Return in words how sure the measured gain is, and whether drift and closures are as sure as they say."""
    sentences = []
    if np.isfinite(verdict.left_out_p):
        share = "below 0.1 %" if verdict.left_out_p < 0.001 else f"{100 * verdict.left_out_p:.2g} %"
        sentences.append(f"So large a gain of closures left out has a probability of {share} by chance alone.")
    if np.isfinite(verdict.variance_factor):
        sentences.append(
            f"The variance factor of the closures at navigation is {numbers.plain(float(verdict.variance_factor))}:"
            " 1 where drift and closures are as sure as they say, more where they are less sure."
        )
    return sentences
