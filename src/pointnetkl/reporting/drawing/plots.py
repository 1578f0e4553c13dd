"""Charts of the results: a figure is a function of a table, and only the report stage saves it."""

import io

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter
from PIL import Image

from pointnetkl.reporting import text_table

# Okabe and Ito's colours, which colour-blind readers tell apart
BLUE, ORANGE, GREEN, RED, PURPLE, SKY, GREY = (
    "#0072B2", "#E69F00", "#009E73", "#D55E00", "#CC79A7", "#56B4E9", "#777777"
)  # fmt: skip
WIDTH_IN, DPI = 8.5, 130
RADIUS_95 = float(np.sqrt(-2 * np.log(0.05)))  # in sigmas, of the ellipse that holds 95 % of a Gaussian in the plane
_LARGEST = 250_000  # bytes of a saved figure: a larger one is saved in 256 colours


def png(figure: Figure) -> bytes:
    """Return the figure as PNG, without dates or version names: the same figure, the same bytes."""
    figure.set_dpi(DPI)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()  # type: ignore[no-untyped-call]
    pixels = np.asarray(canvas.buffer_rgba())  # type: ignore[no-untyped-call]
    image = Image.fromarray(pixels[..., :3])
    whole = _encoded(image)
    return whole if len(whole) < _LARGEST else _encoded(image.quantize(256, dither=Image.Dither.NONE))


def _encoded(image: Image.Image) -> bytes:
    buffer = io.BytesIO()
    image.save(buffer, "PNG")  # optimize=True takes eight times as long and saves 4 %
    return buffer.getvalue()


def plain_log(axes: Axes, axis_name: str) -> None:
    """Write plain numbers at a logarithmic axis, x or y, as many as its decades leave room for."""
    axis, decades = axes.xaxis if axis_name == "x" else axes.yaxis, _decades(axes, axis_name)
    subs = (1.0, 1.5, 2.0, 3.0, 5.0, 7.0) if decades < 0.8 else (1.0, 2.0, 5.0) if decades < 2.5 else (1.0,)
    axis.set_major_locator(LogLocator(subs=subs, numticks=30))
    axis.set_major_formatter(FuncFormatter(lambda value, _: text_table.cell(float(value))))
    axis.set_minor_formatter(NullFormatter())


def _decades(axes: Axes, axis_name: str) -> float:
    low, high = axes.get_xlim() if axis_name == "x" else axes.get_ylim()
    return float(np.log10(high / low)) if low > 0 else np.inf
