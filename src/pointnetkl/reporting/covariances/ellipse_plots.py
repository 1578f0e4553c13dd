"""Submaps with the 95 % ellipses of their labels and of methods, to scale, with the seabed above or beside them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Polygon, Rectangle

from pointnetkl.reporting import paper, text_table
from pointnetkl.reporting.drawing import families, plots
from pointnetkl.reporting.drawing.relief import Relief

_CIRCLE = np.stack([np.cos(t := np.linspace(0, 2 * np.pi, 72, endpoint=False)), np.sin(t)])
_WIDEST = 8.0  # times the label's ellipse: a gallery's frame spans no more, or a large Q would make the others dots
_DOT_IN = 0.02  # a smaller ellipse is drawn as a dot, or it could not be seen
_TEXT_PT, _LINE_IN, _BAR_IN = 8.0, 0.155, 0.22  # text, a line of it, the strip of a scale bar


@dataclass(frozen=True)
class Case:
    """A submap to draw: its seabed, its label and other covariances of it, (M, M) with x, y first, in m^2."""

    survey: str
    submap: int
    seabed: Relief
    label: np.ndarray
    covariances: Mapping[str, np.ndarray]  # by method
    kl: Mapping[str, float]  # of the label from each, nats


@dataclass(frozen=True)
class _Box:
    """A part of a page, inches from its upper left corner."""

    left: float
    top: float
    width: float
    height: float


def gallery(surveys: Mapping[str, Sequence[Case]]) -> Figure:
    """Draw a row of submaps for each survey, in the order given, each above its ellipses."""
    methods = list(dict.fromkeys(method for cases in surveys.values() for case in cases for method in case.covariances))
    high = 3.6 + _LINE_IN * len(methods)
    figure, page = _page(0.45 + high * max(1, len(surveys)))
    _key(page, methods, 0.2)
    for row, (survey, cases) in enumerate(surveys.items()):
        top, width = 0.45 + row * high, (plots.WIDTH_IN - 0.3) / max(1, len(cases))
        _text(page, 0.15, top, f"{paper.title(survey)}, from the largest label to the smallest", size=11)
        for i, case in enumerate(cases):
            _standing(page, case, _Box(0.15 + i * width, top + 0.25, width - 0.15, high))
    return figure


def worst(method: str, cases: Sequence[Case], kl: str = "largest") -> Figure:
    """Draw submaps two in a row, each with the ellipses of its label and of the method's Q on one scale.

    `kl` says in the title by which divergence they were chosen: the largest or the smallest.
    """
    high = 1.32
    figure, page = _page(0.6 + high * max(1, -(-len(cases) // 2)))
    _text(page, 0.15, 0.08, f"{method}: the submaps with the {kl} KL(label || Q)", size=11)
    _key(page, [method], 0.44)
    for i, case in enumerate(cases):
        left, top = 0.15 + (i % 2) * 4.2, 0.6 + (i // 2) * high
        q = case.covariances[method]
        _map(page, case.seabed, _Box(left, top, 1.75, 1.25))
        _ellipses(page, case, _Box(left + 1.8, top, 1.2, 1.2), max(_reach(case.label), _reach(q)))
        words = (
            paper.title(case.survey), f"submap {case.submap}", f"KL {_nats(case.kl[method])} nats",
            "σ of the label:", sigmas(case.label, "\n"), "σ of Q:", sigmas(q, "\n"),
        )  # fmt: skip
        _text(page, left + 3.05, top, "\n".join(words))
    return figure


def sigmas(q: np.ndarray, before_yaw: str = ", ") -> str:
    """Return the larger and smaller principal sigma in x, y of a covariance (M, M), and that of yaw if it has one."""
    small, large = np.sqrt(np.linalg.eigvalsh(q[:2, :2]))
    yaw = f"{before_yaw}{np.degrees(np.sqrt(q[2, 2])):.2g}°" if len(q) > 2 else ""
    return f"{large:.2g} × {small:.2g} m{yaw}"


def boundary(q: np.ndarray) -> np.ndarray:
    """Return the 95 % ellipse in x, y of a covariance (M, M): (2, k) metres to starboard and along the track."""
    x, y = plots.RADIUS_95 * np.linalg.cholesky(q[:2, :2]) @ _CIRCLE
    return np.stack([-y, x])


def _standing(page: Axes, case: Case, box: _Box) -> None:
    """Draw a case from top to bottom: seabed, ellipses, and the divergence of each method."""
    left, top, width = box.left, box.top, box.width
    _text(page, left, top, f"submap {case.submap}")
    _map(page, case.seabed, _Box(left, top + 0.2, width, 1.15))
    widest = _WIDEST * _reach(case.label)
    reach = max(map(_reach, (case.label, *case.covariances.values())))
    _ellipses(page, case, _Box(left, top + 1.4, width, 1.5), min(reach, widest))
    _text(page, left, top + 2.95, f"label: σ {sigmas(case.label)}", families.GOLD.colour)
    for i, (method, q) in enumerate(case.covariances.items(), 1):
        line = f"{method}: {_nats(case.kl[method])} nats{', beyond' if _reach(q) > widest else ''}"
        _text(page, left, top + 2.95 + _LINE_IN * i, line, families.style(method).colour)


def _ellipses(page: Axes, case: Case, box: _Box, reach: float) -> None:
    """Draw a case's ellipses about the middle of a frame that shows `reach` metres and a little more around it."""
    frame = Rectangle((box.left, box.top), box.width, box.height, fill=False, edgecolor="#cccccc")
    page.add_artist(frame)
    metre = (min(box.width, box.height - _BAR_IN) / 2 - 0.06) / reach  # in inches
    middle = np.array([box.left + box.width / 2, box.top + (box.height - _BAR_IN) / 2 + 0.03])
    outlines = [("", families.GOLD, case.label)]
    outlines += [(method, families.style(method), q) for method, q in case.covariances.items()]
    for method, style, q in outlines:
        corners = middle + metre * boundary(q).T * [1, -1]
        if not method:
            page.add_artist(Polygon(corners, color=style.colour, alpha=0.35, linewidth=0)).set_clip_path(frame)
        # add_artist, because add_patch and fill look for the limits of every curve: half of a page's time
        page.add_artist(Polygon(corners, fill=False, edgecolor=style.colour, linewidth=1.4)).set_clip_path(frame)
        if metre * _reach(q) < _DOT_IN:
            page.plot(*middle, "o", color=style.colour, markersize=4)
    _scale(page, box.left + 0.06, box.top + box.height - 0.1, metre, 0.4)


def _map(page: Axes, seabed: Relief, box: _Box) -> None:
    """Draw a submap's seabed, and below it a scale and its relief: the difference between its depths."""
    x0, x1, y0, y1 = seabed.extent
    metre = min(box.width / (x1 - x0), (box.height - _BAR_IN) / (y1 - y0))  # in inches
    width, height = metre * (x1 - x0), metre * (y1 - y0)
    left = box.left + (box.width - width) / 2
    place = (left, left + width, box.top + height, box.top)
    page.imshow(seabed.rgba, extent=place, interpolation="bilinear", aspect="auto")
    depths = text_table.cell(float(np.ptp(seabed.depths_m)), 2)
    _scale(page, box.left, box.top + height + 0.1, metre, 0.6, f", relief {depths} m")


def _scale(page: Axes, left: float, top: float, metre: float, longest: float, more: str = "") -> None:
    """Draw a bar of a round number of metres, at most `longest` inches, and write them at its right."""
    power = 10.0 ** np.floor(np.log10(longest / metre))
    metres = power * max(step for step in (1, 2, 5) if step * power <= longest / metre)
    page.plot([left, left + metres * metre], [top, top], color="black", linewidth=2, solid_capstyle="butt")
    page.text(left + metres * metre + 0.05, top, f"{metres:g} m{more}", fontsize=_TEXT_PT, va="center_baseline")


def _key(page: Axes, methods: Sequence[str], top: float) -> None:
    """Write at the right which colour is of which ellipse."""
    names = [("95 % ellipse of the label", families.GOLD.colour)]
    names += [(f"of {name}", families.style(name).colour) for name in methods]
    left = plots.WIDTH_IN - sum(0.55 + 0.065 * len(name) for name, _ in names)
    for name, colour in names:
        page.plot([left, left + 0.3], [top, top], color=colour, linewidth=2.5)
        page.text(left + 0.36, top, name, fontsize=_TEXT_PT, va="center_baseline")
        left += 0.55 + 0.065 * len(name)


def _page(height: float) -> tuple[Figure, Axes]:
    """Return a figure with axes as large, in inches from its upper left corner: an axes for each box would be slow."""
    figure = Figure((plots.WIDTH_IN, height))
    page = figure.add_axes((0, 0, 1, 1))
    page.set_axis_off()
    page.set(xlim=(0, plots.WIDTH_IN), ylim=(height, 0), autoscale_on=False)
    return figure, page


def _text(page: Axes, left: float, top: float, words: str, colour: str = "black", size: float = _TEXT_PT) -> None:
    page.text(left, top, words, color=colour, fontsize=size, va="top", linespacing=1.25)


def _reach(q: np.ndarray) -> float:
    return plots.RADIUS_95 * float(np.sqrt(np.linalg.eigvalsh(q[:2, :2])[-1]))


def _nats(kl: float) -> str:
    return "< 0.001" if kl < 0.001 else f"{kl:.3f}" if kl < 1 else f"{kl:.3g}"
