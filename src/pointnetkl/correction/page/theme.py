"""Colours and letters of the page's figures, by day and by night."""

from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes

from pointnetkl.reporting.drawing import plots
from pointnetkl.slam.closing.schemas import State

TEXT_PT = 9.5


@dataclass(frozen=True)
class Theme:
    """What a chart is drawn with, so that it stands on the page without a frame."""

    paper: str
    ink: str
    lines: str  # of grid and frame
    before: str
    after: str


DAY = Theme("#ffffff", "#1f2933", "#d5dbe1", "#6b7680", plots.BLUE)
NIGHT = Theme("#161b22", "#e3e8ee", "#3a434e", "#a3adb8", plots.SKY)
# a marker and a colour each, so that neither alone has to tell states apart
STATES = {
    State.ACCEPTED: ("o", plots.BLUE),
    State.UNMATCHED: ("x", "#5f6b76"),
    State.FLAT: ("s", plots.SKY),
    State.RESIDUALS: ("^", plots.ORANGE),
    State.PREDICTION: ("D", plots.RED),
    State.OUTVOTED: ("v", "#a0408c"),
}


def dress(axes: Axes, theme: Theme) -> None:
    """Give axes the theme's colours, and leave of their frame what carries ticks."""
    axes.set_facecolor(theme.paper)
    axes.spines[["top", "right"]].set_visible(False)
    axes.spines[["bottom", "left"]].set_color(theme.lines)
    axes.tick_params(colors=theme.ink, labelsize=TEXT_PT, length=3, color=theme.lines)
    axes.grid(color=theme.lines, linewidth=0.6, alpha=0.7)
    axes.set_axisbelow(True)
    for label in (axes.xaxis.label, axes.yaxis.label, axes.title):
        label.set(color=theme.ink, fontsize=TEXT_PT)


def mark(state: State) -> tuple[str, str, bool]:
    """Return a state's marker as an SVG path about the origin, its colour, and whether it is filled."""
    from matplotlib.markers import MarkerStyle

    name, colour = STATES[state]
    marker = MarkerStyle(name)
    if not marker.is_filled():
        return "M-.5 -.5L.5 .5M-.5 .5L.5 -.5", colour, False
    outline = marker.get_path().transformed(marker.get_transform()).to_polygons()[0]
    corners = [f"{x:.3f} {-y:.3f}" for x, y in np.asarray(outline, np.float64).tolist()]
    return "M" + "L".join(corners) + "Z", colour, True
