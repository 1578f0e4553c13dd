"""The kinds of methods that give a covariance, and how charts tell them apart: by colour and by marker."""

from collections.abc import Iterable
from dataclasses import dataclass

from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from pointnetkl.reporting.drawing import plots


@dataclass(frozen=True)
class Family:
    """Methods of one kind; `members` also counts names that go on after an underscore."""

    name: str
    colour: str
    marker: str
    members: tuple[str, ...]


GOLD = Family("gold standard", plots.GREEN, "*", ("monte_carlo",))
LEARNED = Family("learned numbers", plots.ORANGE, "D", ("constant_train", "structure_tensor", "cello"))
FAMILIES = (
    GOLD,
    Family("the paper's rivals", plots.GREY, "s", ("constant", "naive")),
    Family("closed forms", plots.BLUE, "^", ("hessian", "censi", "unscented", "mean_field")),
    Family("sampled", plots.SKY, "v", ("mc",)),
    LEARNED,
    Family("networks", plots.RED, "o", ("pointnetkl", "network")),
)
_OTHERS = Family("others", plots.PURPLE, "X", ())


def of(method: str) -> Family:
    """Return the family of a method; one that nobody sorted in is among the others."""
    if method in LEARNED.members:  # constant_train, which is not the paper's constant
        return LEARNED
    kin = (f for f in FAMILIES if any(f"{method}_".startswith(f"{member}_") for member in f.members))
    return next(kin, _OTHERS)


def legend(figure: Figure, methods: Iterable[str]) -> None:
    """Write above a figure which colour and marker is which of the methods' families."""
    present = {of(method) for method in methods}
    handles = [
        Line2D([], [], color=each.colour, marker=each.marker, linestyle="", label=each.name)
        for each in (*FAMILIES, _OTHERS)
        if each in present
    ]
    if handles:
        figure.legend(
            handles=handles, loc="outside upper center", ncols=len(handles), frameon=False,
            fontsize=9, columnspacing=1.2, handletextpad=0.1,
        )  # fmt: skip
