"""The page put together: figures, numbers and words into its template."""

import base64
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from pointnetkl.correction.page import charts, maps, numbers, rasters, theme, words
from pointnetkl.correction.page.rasters import Raster
from pointnetkl.correction.result import Corrected
from pointnetkl.reporting.drawing import plots
from pointnetkl.surveys.survey import SWATHS

LARGEST_BYTES = 1_900_000  # of the page
_SCALES = (1.0, 0.75, 0.55, 0.4)  # of the maps, until the page is no larger


@dataclass(frozen=True)
class Picture:
    """A figure as the template takes it."""

    alt: str
    day: str  # data URI
    night: str = ""  # the same for dark screens; a map has one for both
    width: int = 0  # pixels, so that the page does not jump while it loads
    height: int = 0


@dataclass(frozen=True)
class Bar:
    """A bar of colours: a CSS gradient, and its ticks as shares of its length and their words."""

    gradient: str
    ticks: list[tuple[float, str]]
    label: str


def page(folder: Path, corrected: Corrected, facts: Mapping[str, Any]) -> str:
    """Return the page as HTML.

    Raises:
        CorrectionError: a map in the folder cannot be read.
    """
    before, after = (rasters.read(folder / f"map_{name}.tif", "Depth") for name in ("before", "after"))
    difference = rasters.read(folder / "difference.tif", "Difference") if corrected.verdict.applied else None
    shown = {"before": before, "after": after if corrected.verdict.applied else None, "difference": difference}
    context = _text(folder, corrected, facts) | _charts(corrected, facts)
    for scale in _SCALES:
        html = _template().render(context | _maps(corrected, shown, scale))
        if len(html.encode()) <= LARGEST_BYTES:
            break
    return html


def _template() -> Any:
    import jinja2

    environment = jinja2.Environment(
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    return environment.from_string(Path(__file__).with_name("page.html").read_text(encoding="utf-8"))


def _text(folder: Path, corrected: Corrected, facts: Mapping[str, Any]) -> dict[str, Any]:
    states = numbers.by_state(corrected.closures)
    return {
        "survey": corrected,
        "verdict": corrected.verdict,
        "line": words.survey_line(corrected),
        "numbers": numbers.headline(corrected),
        "agreement_rows": numbers.agreement(corrected.verdict),
        "chances": words.chances(corrected.verdict),
        "states": [(theme.mark(state), words.STATES[state], count) for state, count in states.items()],
        "residuals": [_residual(row, corrected) for row in numbers.largest_residuals(corrected.closures).itertuples()],
        "moved": corrected.rms_moved_m > 0,
        "times": corrected.kind == SWATHS,
        "problems": list(facts.get(words.PROBLEMS, ())),
        "left_out": list(facts.get(words.LEFT_OUT, ())),
        "parameters": str(facts.get(words.PARAMETERS, "")),
        "products": words.products(folder),
        **_others(corrected, facts),
    }


def _others(corrected: Corrected, facts: Mapping[str, Any]) -> dict[str, Any]:
    """Return the facts that have no place of their own: rows of a table, and lists."""
    apart = {words.PROBLEMS, words.LEFT_OUT, words.PARAMETERS, *words.DISAGREEMENT}
    said = {"drift assumed": corrected.verdict.drift, **facts}
    rest = {name: value for name, value in said.items() if name not in apart and value not in (None, "", [], ())}
    lists = {name: value for name, value in rest.items() if isinstance(value, list | tuple)}
    return {"lists": lists, "facts": {name: numbers.plain(value) for name, value in rest.items() if name not in lists}}


def _residual(row: Any, corrected: Corrected) -> dict[str, str]:
    target = "reference" if row.target < 0 else str(row.target)
    shift = np.linalg.norm(np.array([row.shift_x_m, row.shift_y_m], float))  # None becomes NaN
    return {
        "source": str(row.source),
        "target": target,
        "time": words.utc(row.time_s) if corrected.kind == SWATHS and np.isfinite(row.time_s) else "",
        "overlap": numbers.plain(float(row.overlap_m2)),
        "shift": numbers.length(float(shift)),
        "before": numbers.sigmas(row.sigmas_before),
        "after": numbers.sigmas(row.sigmas_after),
        "left_out": numbers.length(row.left_out_m),
        "state": words.STATES[row.state][0],
    }


def _charts(corrected: Corrected, facts: Mapping[str, Any]) -> dict[str, Picture | None]:
    pictures: dict[str, Picture | None] = {"shift": None, "agreement": None}
    if len(corrected.track):
        pictures["shift"] = _chart(lambda theme: charts.shift(corrected, theme), words.shift_alt(corrected))
    before, after = (facts.get(name) for name in words.DISAGREEMENT)
    cells = None if before is None or after is None else (np.asarray(before, np.float64), np.asarray(after, np.float64))
    after_is = "after" if corrected.verdict.applied else "if corrected"
    if curves := numbers.curves(corrected.closures, cells):
        alt = words.agreement_alt(curves, after_is)
        pictures["agreement"] = _chart(lambda theme: charts.agreement(curves, after_is, theme), alt)
    return pictures


def _chart(draw: Callable[[theme.Theme], Figure], alt: str) -> Picture:
    day, night = (_png(draw(each)) for each in (theme.DAY, theme.NIGHT))
    return Picture(alt, day[0], night[0], *day[1:])


def _maps(corrected: Corrected, shown: Mapping[str, Raster | None], scale: float) -> dict[str, Any]:
    before, after, difference = (shown[name] for name in ("before", "after", "difference"))
    drawn: dict[str, Any] = dict.fromkeys(("before", "after", "closures", "difference", "depths", "deeper"))
    if not (seen := [raster for raster in (before, after) if raster is not None]):
        return drawn
    look = maps.look(seen, scale)
    track = corrected.submaps is not None
    for name, raster, when in (("before", before, "as navigated"), ("after", after, "as corrected")):
        if raster is not None:
            figure = maps.seabed(raster, look, corrected, name == "after")
            drawn[name] = _picture(figure, words.seabed_alt(raster, when, track))
    if track and len(corrected.closures):
        drawn["closures"] = _picture(maps.closures(seen[-1], look, corrected), words.closures_alt(corrected))
    if difference is not None:
        figure, reach = maps.difference(difference, look)
        drawn["difference"] = _picture(figure, words.difference_alt(difference))
        drawn["deeper"] = _bar(
            colormaps[maps.DIFFERENCE](np.linspace(0, 1, 13))[:, :3], (-reach, reach), "Deeper after by (m)"
        )
    level = f" ({', '.join(corrected.vertical)})" if corrected.vertical else ""
    drawn["depths"] = _bar(maps.pale(np.linspace(0, 1, 13)), look.depths, f"Depth (m){level}")
    return drawn


def _picture(figure: Figure, alt: str) -> Picture:
    uri, width, height = _png(figure)
    return Picture(alt, uri, "", width, height)


def _png(figure: Figure) -> tuple[str, int, int]:
    data = base64.b64encode(plots.png(figure)).decode()
    width, height = (round(inches * plots.DPI) for inches in figure.get_size_inches())
    return f"data:image/png;base64,{data}", width, height


def _bar(colours: np.ndarray, ends: tuple[float, float], label: str) -> Bar:
    stops = ", ".join("#" + "".join(f"{round(255 * part):02x}" for part in colour) for colour in colours)
    low, high = ends
    values = np.asarray(MaxNLocator(5, steps=[1, 2, 2.5, 5, 10]).tick_values(low, high))
    places = 100 * (values - low) / (high - low)
    inside = (places > 2) & (places < 98)  # or a narrow screen would cut the words
    digits = max(0, min(4, 2 - int(np.floor(np.log10((high - low) / 5)))))
    texts = [np.format_float_positional(value, digits, trim="-").replace("-", "−") for value in values[inside]]
    return Bar(stops, list(zip(places[inside].round(2).tolist(), texts, strict=True)), label)
