"""Tables for people and for programs: numbers to 4 digits, a dash where a value is not known, never NaN."""

import html
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import pandas as pd

DIGITS = 4  # significant, so that a comparison of two runs shows changes and not noise
_PRINTED = 6  # digits, of the paper's own numbers: as it prints them
UNKNOWN = "—"


@dataclass(frozen=True)
class Block:
    """One table: its caption, and rows of numbers and text; None where a value is not known."""

    caption: str
    frame: pd.DataFrame


Blocks = Mapping[str, Sequence[Block]]  # a report's tables, by the stems of their files
Numbers = Mapping[str, Any]  # nested numbers, as metrics.json has them


def block(caption: str, rows: Sequence[Mapping[str, Any]], columns: Sequence[str]) -> Block:
    """Return a block of the rows, with the columns in this order, values as they came (None stays None)."""
    cells = [[row.get(name) for name in columns] for row in rows]
    return Block(caption, pd.DataFrame(cells, columns=list(columns), dtype=object))


def heading(survey: str, datasets: Numbers) -> str:
    """Return a survey's name as the head of a column, which says that it is simulated where it is."""
    return f"{survey} (simulated)" if datasets[survey]["simulated"] else survey


def interval(ci95: Any) -> dict[str, Any]:
    """Return an interval (low, high), or None, as the cells ci_low and ci_high."""
    low, high = ci95 or (None, None)
    return {"ci_low": low, "ci_high": high}


def by_method(numbers: Numbers, datasets: Numbers) -> Iterator[dict[str, Any]]:
    """Yield a row for each survey and method of {survey: {method: {column: value}}}; other entries are left out."""
    for survey, methods in numbers.items():
        for method, values in methods.items() if isinstance(methods, Mapping) else ():
            if isinstance(values, Mapping):
                yield {"survey": survey, "simulated": datasets[survey]["simulated"], "method": method, **values}


def rounded(value: Any, digits: int = DIGITS) -> Any:
    """Return numbers to so many significant digits, in nested containers too; NaN and infinity become None."""
    if isinstance(value, Mapping):
        return {key: rounded(inner, digits) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [rounded(inner, digits) for inner in value]
    if isinstance(value, float):
        return float(f"{value:.{digits}g}") if math.isfinite(value) else None
    return value


def cell(value: Any, digits: int = DIGITS) -> str:
    """Return a value as text: so many significant digits, and an exponent only for numbers below 1e-4."""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if value is None or (isinstance(value, float) and not math.isfinite(value)):
        return UNKNOWN
    if not isinstance(value, float):
        return str(value)
    size = abs(value)
    if size >= 10**digits:
        return f"{value:.0f}"
    return f"{value:.{digits}g}" if size >= 1e-4 or value == 0 else f"{value:.1e}"


def csv(frame: pd.DataFrame) -> str:
    """Return a table as CSV: numbers rounded, an empty field where a value is not known."""
    values = {name: [rounded(v, _digits(name)) for v in frame[name]] for name in frame.columns}
    return str(pd.DataFrame(values, dtype=object).to_csv(index=False, lineterminator="\n"))


def markdown(blocks: Sequence[Block]) -> str:
    """Return tables as Markdown, numbers to the right."""
    return "\n\n".join(f"{b.caption}\n\n{_markdown(b.frame)}" for b in blocks) + "\n"


def to_html(blocks: Sequence[Block]) -> str:
    """Return tables as HTML, each in a box that scrolls sideways on a narrow screen."""
    return "\n".join(_html(b) for b in blocks)


def _markdown(frame: pd.DataFrame) -> str:
    right = [_is_number(frame[name]) for name in frame.columns]
    text = [list(frame.columns), *_cells(frame)]
    widths = [max(3, *(len(row[i]) for row in text)) for i in range(len(right))]
    rules = ["-" * (w - 1) + (":" if r else "-") for w, r in zip(widths, right, strict=True)]
    lines = [_markdown_line(row, widths, right) for row in text]
    return "\n".join([lines[0], "|" + "|".join(f" {rule} " for rule in rules) + "|", *lines[1:]])


def _markdown_line(row: Sequence[str], widths: Sequence[int], right: Sequence[bool]) -> str:
    padded = (t.rjust(w) if r else t.ljust(w) for t, w, r in zip(row, widths, right, strict=True))
    return "| " + " | ".join(padded) + " |"


def _html(b: Block) -> str:
    kinds = ["number" if _is_number(b.frame[name]) else "text" for name in b.frame.columns]
    head = "".join(_tag("th", k, name) for name, k in zip(b.frame.columns, kinds, strict=True))
    rows = (
        "<tr>" + "".join(_tag("td", k, text) for text, k in zip(row, kinds, strict=True)) + "</tr>"
        for row in _cells(b.frame)
    )
    return (
        f'<div class="table"><table><caption>{html.escape(b.caption)}</caption>'
        f"<thead><tr>{head}</tr></thead><tbody>{''.join(rows)}</tbody></table></div>"
    )


def _tag(name: str, kind: str, text: str) -> str:
    # a long column's name may break at its underscores
    breakable = html.escape(text).replace("_", "_<wbr>") if name == "th" else html.escape(text)
    return f'<{name} class="{kind}">{breakable}</{name}>'


def _cells(frame: pd.DataFrame) -> list[list[str]]:
    digits = [_digits(name) for name in frame.columns]
    return [[cell(v, d) for v, d in zip(row, digits, strict=True)] for row in frame.itertuples(index=False)]


def _digits(column: object) -> int:
    return _PRINTED if str(column).startswith("paper") else DIGITS


def _is_number(column: pd.Series) -> bool:
    return all(not isinstance(v, str | bool) for v in column if v is not None)
