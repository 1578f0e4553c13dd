"""The report as one page: it needs no file beside it and nothing from a network, and is readable on a phone.

Its bytes do not depend on the machine that makes it. What does is in this_machine.js, which the page loads if it is
there: on another machine than its times were measured on, the page says so.
"""

import base64
import html
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from pointnetkl.reporting import text_table
from pointnetkl.reporting.text_table import Block

THIS_MACHINE = "this_machine.js"
_STYLE = """
:root { color-scheme: light; }
body { font: 16px/1.5 system-ui, sans-serif; color: #1a1a1a; background: #fff; }
body { margin: 0 auto; max-width: 62rem; padding: 1rem; }
h1 { font-size: 1.5rem; line-height: 1.25; }
h2 { font-size: 1.2rem; margin-top: 2.5rem; border-top: 1px solid #ddd; padding-top: 1rem; }
p { max-width: 46rem; } .note { background: #fff6e0; border-left: 4px solid #e69f00; padding: .5rem .8rem; }
.table { overflow-x: auto; margin: 1rem 0; }
table { border-collapse: collapse; font-size: .85rem; font-variant-numeric: tabular-nums; }
caption { text-align: left; font-weight: 600; padding-bottom: .3rem; }
th, td { padding: .2rem .6rem; border-bottom: 1px solid #e5e5e5; white-space: nowrap; }
th { background: #f4f4f4; vertical-align: bottom; white-space: normal; }
th:first-child, td:first-child { position: sticky; left: 0; background: #fff; }
th:first-child { background: #f4f4f4; } .number { text-align: right; } .text { text-align: left; }
tbody tr:hover { background: #f3f8fc; }
figure { margin: 1rem 0; }
.image { overflow-x: auto; } img { width: 100%; min-width: 36rem; height: auto; }
figcaption { font-size: .9rem; color: #444; }
nav a { margin-right: .9rem; }
"""
_ELSEWHERE = """
for (const note of document.querySelectorAll("[data-measured-on]")) {
  const measuredOn = note.dataset.measuredOn;
  if (typeof THIS_MACHINE === "undefined" || THIS_MACHINE === measuredOn) continue;
  note.textContent = `This page was made on ${THIS_MACHINE}; ${note.dataset.times} was measured on ${measuredOn}:`
    + " its seconds are not those of this machine.";
  note.hidden = false;
}
"""


@dataclass(frozen=True)
class Measured:
    """Where the times of a table were measured."""

    times: str  # the table's name
    machine: str
    again: str  # how to measure them elsewhere


@dataclass(frozen=True)
class Section:
    """A part of the page: what is shown, how to read it, and what must be known to judge it."""

    title: str
    paragraphs: Sequence[str]
    blocks: Sequence[Block] = ()
    figures: Mapping[str, str] = field(default_factory=dict)  # a figure's name, and its caption
    notes: Sequence[str] = ()
    measured: Measured | None = None  # if the tables are of times


def render(title: str, lead: Sequence[str], sections: Sequence[Section], images: Mapping[str, bytes]) -> str:
    """Return the page; `images` are PNG files by the names that sections give."""
    links = " ".join(f'<a href="#s{i}">{html.escape(s.title)}</a>' for i, s in enumerate(sections))
    body = "\n".join(_section(f"s{i}", section, images) for i, section in enumerate(sections))
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{html.escape(title)}</title>\n<style>{_STYLE}</style>\n</head>\n<body>\n"
        f"<h1>{html.escape(title)}</h1>\n{_paragraphs(lead)}\n<nav>{links}</nav>\n{body}\n"
        f'<script src="{THIS_MACHINE}"></script>\n<script>{_ELSEWHERE}</script>\n</body>\n</html>\n'
    )


def _section(anchor: str, section: Section, images: Mapping[str, bytes]) -> str:
    figures = "\n".join(_figure(images[name], caption) for name, caption in section.figures.items() if name in images)
    parts = (
        f'<h2 id="{anchor}">{html.escape(section.title)}</h2>',
        _paragraphs(section.paragraphs),
        text_table.to_html(section.blocks),
        _measured(section.measured) if section.measured else "",
        figures,
        "\n".join(f'<p class="note">{_text(note)}</p>' for note in section.notes),
    )
    return "\n".join(part for part in parts if part)


def this_machine(machine: str) -> bytes:
    """Return the file THIS_MACHINE for a page that is made on this machine."""
    return f"const THIS_MACHINE = {json.dumps(machine)};\n".encode()


def _measured(measured: Measured) -> str:
    statement = _text(f"{measured.times} was measured on {measured.machine}. {measured.again}")
    data = f'data-times="{html.escape(measured.times)}" data-measured-on="{html.escape(measured.machine)}"'
    return f'<p>{statement}</p>\n<p class="note" {data} hidden></p>'


def _figure(png: bytes, caption: str) -> str:
    data = base64.b64encode(png).decode()
    text = html.escape(caption)
    image = f'<div class="image"><img alt="{text}" src="data:image/png;base64,{data}"></div>'
    return f"<figure>{image}<figcaption>{text}</figcaption></figure>"


def _paragraphs(texts: Sequence[str]) -> str:
    return "\n".join(f"<p>{_text(text)}</p>" for text in texts)


def _text(text: str) -> str:
    """Return text as HTML; what stands in backticks is code."""
    return re.sub(r"`([^`]+)`", r"<code>\1</code>", html.escape(text))
