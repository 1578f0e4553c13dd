"""Sheets of small maps: panels placed in inches, without ticks, and bars that tell their scale.

Matplotlib's own layout of many panels takes longer than all that is drawn in them, and so do their axes.
"""

from dataclasses import dataclass

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from pointnetkl.reporting.drawing import plots

TEXT_PT = 8.0
GAP_IN, LINE_IN = 0.06, 0.17  # between the maps of a grid, and for a map's title
_MARGIN_IN = 0.1  # at the left and right of a grid
_LONGEST = 0.4  # of a panel's width, that a scale bar takes


def sheet(height: float) -> Figure:
    """Return an empty figure as wide as all others and `height` inches high."""
    return Figure((plots.WIDTH_IN, height))


def no_track() -> Figure:
    """Return a figure that says that SLAM has nothing to show: every test survey is of points."""
    return nothing("no test survey has a track")


def no_held_out() -> Figure:
    """Return a figure that says why there is nothing to draw of held-out errors."""
    return nothing("no held-out errors: label.held_out_runs is 0")


def nothing(words: str) -> Figure:
    """Return a figure that says why there is nothing to draw."""
    figure = sheet(0.6)
    figure.text(0.5, 0.5, words, ha="center", va="center", fontsize=10)
    return figure


def limits(points: np.ndarray, flattest: float = 0.3, highest: float = 1.7) -> np.ndarray:
    """Return the corners [[x, y], [x, y]] of a map that holds points (n, 2), with some room around them, metres.

    Its height is at least `flattest` and at most `highest` times its width.
    """
    low, high = points.min(axis=0), points.max(axis=0)
    size = (high - low) * 1.06 + 1e-3
    size = np.maximum(size, [size[1] / highest, size[0] * flattest])
    middle = (low + high) / 2
    return np.stack([middle - size / 2, middle + size / 2])


def height(corners: np.ndarray, width: float) -> float:
    """Return how high, in inches, a map between these corners is that is `width` inches wide."""
    wide, high = corners[1] - corners[0]
    return float(width * high / wide)


def panel(figure: Figure, left: float, top: float, width: float, corners: np.ndarray) -> Axes:
    """Return axes for a map between corners, metres, their upper left corner there, inches from that of the sheet."""
    page_width, page_height = figure.get_size_inches()
    high = height(corners, width)
    place = (left / page_width, 1 - (top + high) / page_height, width / page_width, high / page_height)
    axes = figure.add_axes(place)
    axes.set(xlim=corners[:, 0], ylim=corners[:, 1], xticks=[], yticks=[], autoscale_on=False)
    axes.spines[:].set_color("#cccccc")
    return axes


@dataclass(frozen=True)
class Grid:
    """Maps of one size in rows of so many, all in one axes: what is drawn on one is moved to its place."""

    axes: Axes
    corners: np.ndarray  # of each map, metres
    across: int
    inch: float  # in metres of the map

    def place(self, index: int, title: str) -> tuple[np.ndarray, Rectangle]:
        """Frame a map and write its title; return what is added to its points, metres, and the frame to clip by."""
        row, column = divmod(index, self.across)
        low, size = self.corners[0], self.corners[1] - self.corners[0]
        step = size + self.inch * np.array([GAP_IN, GAP_IN + LINE_IN])
        offset = step * [column, -row]
        frame = Rectangle(tuple(low + offset), *size, fill=False, edgecolor="#cccccc", linewidth=0.8)
        self.axes.add_artist(frame)
        x, y = low + offset + [0, size[1]]
        self.axes.text(x, y + 0.03 * self.inch, title, fontsize=TEXT_PT - 0.5, va="bottom")
        return offset, frame

    def draw(self, artist: Artist, frame: Rectangle) -> None:
        """Add what is drawn on a map, without what lies outside its frame."""
        self.axes.add_artist(artist).set_clip_path(frame)


def grid(figure: Figure, top: float, corners: np.ndarray, count: int, across: int) -> Grid:
    """Return room for `count` maps between corners, metres, the first row's titles at `top` inches."""
    width = map_width(across)
    inch = float((corners[1] - corners[0])[0]) / width
    high = grid_height(corners, count, across)
    low, first = corners[0], corners[1, 1] + LINE_IN * inch
    whole = np.array([[low[0], first - high * inch], [low[0] + (plots.WIDTH_IN - 2 * _MARGIN_IN) * inch, first]])
    axes = panel(figure, _MARGIN_IN, top, plots.WIDTH_IN - 2 * _MARGIN_IN, whole)
    axes.set_axis_off()
    return Grid(axes, corners, across, inch)


def map_width(across: int) -> float:
    """Return how wide, in inches, each map of a grid with so many in a row is."""
    return (plots.WIDTH_IN - 2 * _MARGIN_IN) / across - GAP_IN


def grid_height(corners: np.ndarray, count: int, across: int) -> float:
    """Return how high, in inches, a grid of so many maps is, with their titles."""
    return -(-count // across) * (height(corners, map_width(across)) + LINE_IN + GAP_IN)


def write(figure: Figure, left: float, top: float, words: str, size: float = TEXT_PT, colour: str = "black") -> None:
    """Write words, their upper left corner there, inches from that of the sheet."""
    page_width, page_height = figure.get_size_inches()
    figure.text(left / page_width, 1 - top / page_height, words, fontsize=size, color=colour, va="top")


def scale_bar(axes: Axes, corners: np.ndarray | None = None) -> None:
    """Draw a bar of a round number of metres at the lower left of a map, by default the whole axes, with its length."""
    (x0, y0), (x1, _) = np.transpose([axes.get_xlim(), axes.get_ylim()]) if corners is None else corners
    wide = x1 - x0
    length, x, y = round_below(_LONGEST * wide), x0 + 0.04 * wide, y0 + 0.04 * wide
    axes.plot([x, x + length], [y, y], color="black", linewidth=2, solid_capstyle="butt", zorder=5)
    words = f"{length / 1000:g} km" if length >= 1000 else f"{length:g} m" if length >= 1 else f"{length * 100:g} cm"
    box = {"facecolor": "white", "alpha": 0.7, "linewidth": 0, "pad": 0.5}
    axes.text(x, y + 0.03 * wide, words, fontsize=TEXT_PT - 1, va="bottom", bbox=box, zorder=5)


def round_below(value: float) -> float:
    """Return the largest of 1, 2 and 5 times a power of ten that is not above a positive value."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(power * max(step for step in (1, 2, 5) if step * power <= value * (1 + 1e-9)))
