"""How charts tell families of methods apart: by colour and by marker."""

from collections.abc import Iterable
from dataclasses import dataclass

from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from pointnetkl.registration.covariance import catalogue
from pointnetkl.registration.covariance.catalogue import Family
from pointnetkl.reporting.drawing import plots


@dataclass(frozen=True)
class Style:
    """How the methods of a family are drawn."""

    colour: str
    marker: str


STYLES = {
    Family.GOLD: Style(plots.GREEN, "*"),
    Family.RIVALS: Style(plots.GREY, "s"),
    Family.CLOSED_FORMS: Style(plots.BLUE, "^"),
    Family.SAMPLED: Style(plots.SKY, "v"),
    Family.LEARNED: Style(plots.ORANGE, "D"),
    Family.NETWORKS: Style(plots.RED, "o"),
    Family.OTHERS: Style(plots.PURPLE, "X"),
}
GOLD = STYLES[Family.GOLD]


def style(method: str) -> Style:
    """Return how a method is drawn."""
    return STYLES[catalogue.family(method)]


def legend(figure: Figure, methods: Iterable[str]) -> None:
    """Write above a figure the colours and markers of the methods' families."""
    present = {catalogue.family(method) for method in methods}
    handles = [
        Line2D([], [], color=each.colour, marker=each.marker, linestyle="", label=str(family))
        for family, each in STYLES.items()
        if family in present
    ]
    if handles:
        figure.legend(
            handles=handles, loc="outside upper center", ncols=len(handles), frameon=False,
            fontsize=9, columnspacing=1.2, handletextpad=0.1,
        )  # fmt: skip
