"""The page says where its times were measured, and on another machine that it was made on another."""

import json
import re
import shutil
import subprocess

import pytest

from pointnetkl.reporting import page
from pointnetkl.reporting.covariances import words
from pointnetkl.reporting.text_table import Block
from pointnetkl.workflow import machine

MEASURED = {"cpu": 'Fast "Chip" <9>', "cores": 2}
NAME = 'Fast "Chip" <9>, 2 cores'
# A browser's document with one note, which prints what it holds in the end
DOCUMENT = """
const note = {hidden: true, textContent: "", dataset: {times: "Table III", measuredOn: %s}};
const document = {querySelectorAll: (selector) => selector === "[data-measured-on]" ? [note] : []};
"""


@pytest.fixture(scope="module")
def rendered() -> str:
    """A page of the section of Table III alone."""
    section = words.time({"table_3": list[Block]()}, {"machine": MEASURED})
    return page.render("Times", [], [section], {})


def test_the_page_names_the_machine_of_table_3_and_how_to_measure_it_elsewhere(rendered: str):
    assert "Table III was measured on Fast &quot;Chip&quot; &lt;9&gt;, 2 cores." in rendered
    assert "<code>dvc repro --force --single-item time &amp;&amp; dvc repro report</code>" in rendered


def test_the_page_does_not_depend_on_the_machine_that_makes_it(rendered: str, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(machine, "processor", lambda: "another")
    section = words.time({"table_3": list[Block]()}, {"machine": MEASURED})
    assert page.render("Times", [], [section], {}) == rendered
    assert page.this_machine(machine.in_words(machine.describe())).startswith(b'const THIS_MACHINE = "another, ')


def test_what_depends_on_the_machine_is_in_a_file_that_the_page_loads(rendered: str):
    assert re.findall(r'<script src="([^"]*)">', rendered) == [page.THIS_MACHINE]


@pytest.mark.skipif(shutil.which("node") is None, reason="no node to run the page's script with")
@pytest.mark.parametrize(
    ("side_file", "said"),
    [
        (page.this_machine("Slow, 1 core"), f"This page was made on Slow, 1 core; Table III was measured on {NAME}:"),
        (page.this_machine(NAME), None),
        (b"", None),  # the page alone
    ],
)
def test_a_sentence_below_the_table_says_that_the_page_was_made_elsewhere(
    rendered: str, side_file: bytes, said: str | None
):
    (script,) = re.findall(r"<script>(.*?)</script>", rendered, re.DOTALL)
    program = side_file.decode() + DOCUMENT % json.dumps(NAME) + script + "console.log(JSON.stringify(note))"
    done = subprocess.run(["node", "-e", program], capture_output=True, text=True, check=True)
    note = json.loads(done.stdout)
    assert note["hidden"] is (said is None)
    assert note["textContent"].startswith(said or "")
