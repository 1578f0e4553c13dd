"""Plots of the swaths of a raw file: profiles of some, and an image of depth by beam and ping."""

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from pointnetkl.reporting.drawing import plots, sheet
from pointnetkl.reporting.drawing.maps import DEPTHS

_LEFT_IN, _TOP_IN, _WIDTH_IN = 0.8, 0.62, 6.7
_PROFILE_IN, _IMAGE_IN, _BETWEEN_IN = 2.7, 3.2, 0.95
_COLOURS = (plots.BLUE, plots.ORANGE, plots.GREEN, plots.RED, plots.PURPLE, plots.SKY, plots.GREY)
_MOST_BEAMS = 4096  # rows of the image; larger beam numbers are names and not places
_ROOM = 1.1


def swaths(soundings: pd.DataFrame, pings: pd.DataFrame, title: str) -> Figure:
    """Draw profiles of some pings, depth against distance across the track, and below them depth by beam and ping.

    `soundings` are valid and belong to some of the `pings` (survey.SOUNDINGS, survey.PINGS).
    """
    figure = Figure((plots.WIDTH_IN, _TOP_IN + _PROFILE_IN + _BETWEEN_IN + _IMAGE_IN + 0.6))
    across = _across(soundings, pings)
    profile = placed(figure, _LEFT_IN, _TOP_IN, _WIDTH_IN, _PROFILE_IN)
    _profiles(profile, soundings, across)
    top = _TOP_IN + _PROFILE_IN + _BETWEEN_IN
    image = placed(figure, _LEFT_IN, top, _WIDTH_IN, _IMAGE_IN)
    bar = placed(figure, _LEFT_IN + _WIDTH_IN + 0.15, top, 0.14, _IMAGE_IN)
    _image(image, bar, soundings, across)
    sheet.write(figure, 0.1, 0.08, title, 10)
    for axes in (profile, image, bar):
        axes.tick_params(labelsize=sheet.TEXT_PT)
    return figure


def placed(figure: Figure, left: float, top: float, width: float, height: float) -> Axes:
    """Return axes of a size in inches, at a place in inches from the upper left corner of the figure."""
    wide, high = figure.get_size_inches()
    return figure.add_axes((left / wide, 1 - (top + height) / high, width / wide, height / high))


def _across(soundings: pd.DataFrame, pings: pd.DataFrame) -> np.ndarray:
    """Return the distance (n,) of soundings to starboard of their ping, metres."""
    ping = pings.iloc[soundings["ping"].to_numpy()]
    yaw = ping["yaw_rad"].to_numpy()
    east, north = ((soundings[name].to_numpy() - ping[name].to_numpy()) for name in ("x_m", "y_m"))
    return np.asarray(east * np.sin(yaw) - north * np.cos(yaw))


def _profiles(axes: Axes, soundings: pd.DataFrame, across: np.ndarray) -> None:
    numbers = soundings["ping"].unique()
    selected = numbers[np.unique(np.linspace(0, len(numbers) - 1, len(_COLOURS)).round().astype(int))]
    depth = -soundings["z_m"].to_numpy()
    shown = np.isin(soundings["ping"], selected)
    size = 2.0 if shown.sum() > 100 * len(selected) else 4.0
    for number, colour in zip(selected.tolist(), _COLOURS, strict=False):
        rows = soundings["ping"].to_numpy() == number
        axes.plot(across[rows], depth[rows], ".", color=colour, markersize=size, label=f"ping {number}")
    times = _limits(axes, across[shown], depth[shown])
    axes.set(xlabel="across the track (m), starboard positive", ylabel="depth (m)")
    axes.set_title(f"profiles of {len(selected)} pings, depth {times}", fontsize=9)
    axes.grid(alpha=0.3)
    axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize=sheet.TEXT_PT, frameon=False, markerscale=3)


def _limits(axes: Axes, across: np.ndarray, depth: np.ndarray) -> str:
    """Set the limits so that depths are stretched by a round number; return that number in words."""
    wide = _ROOM * max(float(np.ptp(across)), 1.0)
    high = _ROOM * max(float(np.ptp(depth)), 0.1)
    fits = (wide / _WIDTH_IN) / (high / _PROFILE_IN)
    stretch = sheet.round_below(fits) if fits >= 1 else 1.0
    per_inch = max(wide / _WIDTH_IN, high / _PROFILE_IN if fits < 1 else 0.0)  # metres across
    middle, deep = (across.min() + across.max()) / 2, (depth.min() + depth.max()) / 2
    half = per_inch / stretch * _PROFILE_IN / 2
    axes.set(xlim=(middle - per_inch * _WIDTH_IN / 2, middle + per_inch * _WIDTH_IN / 2))
    axes.set(ylim=(deep + half, deep - half))
    return "to scale" if stretch == 1 else f"{stretch:g} times stretched"


def _image(axes: Axes, bar: Axes, soundings: pd.DataFrame, across: np.ndarray) -> None:
    ping, beam = soundings["ping"].to_numpy(), soundings["beam"].to_numpy()
    numbers, column = np.unique(ping, return_inverse=True)
    rows, row = np.unique(beam, return_inverse=True)
    first, last = int(rows[0]), int(rows[-1])
    if last - first < _MOST_BEAMS:
        row, count, label = beam - first, last - first + 1, "beam"
    else:
        first, last, count, label = 0, len(rows) - 1, len(rows), "beams in order of their numbers"
    depth = np.full((count, len(numbers)), np.nan)
    depth[row, column] = -soundings["z_m"].to_numpy()
    low, high = np.nanquantile(depth, [0.01, 0.99])
    extent = (numbers[0] - 0.5, numbers[-1] + 0.5, last + 0.5, first - 0.5)
    drawn = axes.imshow(depth, cmap=DEPTHS, vmin=low, vmax=high, extent=extent, aspect="auto", interpolation="nearest")
    axes.set_facecolor("#dddddd")
    axes.figure.colorbar(drawn, cax=bar, label="depth (m)", extend="both")
    bar.invert_yaxis()
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(MaxNLocator(8, integer=True))
    sides = ("port", "starboard") if _rises(row, across) else ("starboard", "port")
    axes.set(xlabel="ping", ylabel=f"{label} ({sides[0]} above)")
    axes.set_title("valid soundings by ping and beam; grey: none", fontsize=9)


def _rises(row: np.ndarray, across: np.ndarray) -> bool:
    return bool(np.sum((row - row.mean()) * (across - across.mean())) >= 0)
