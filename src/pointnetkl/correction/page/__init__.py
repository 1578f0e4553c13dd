"""The report of a correction: one page that needs no file beside it and no network; first the answer, then the details.

The products beside it are linked. Scripts it has none; it is readable on a phone, by night and on paper.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pointnetkl.correction.page.words import DISAGREEMENT, LEFT_OUT, PARAMETERS, PROBLEMS
from pointnetkl.correction.result import Corrected

__all__ = ["DISAGREEMENT", "LEFT_OUT", "PARAMETERS", "PROBLEMS", "REPORT", "write"]

REPORT = "report.html"


def write(folder: Path, corrected: Corrected, facts: Mapping[str, Any]) -> None:
    """Write the page into the folder, in which the products already are.

    `facts` are shown by their names in the order given: a number or a text is a row of a table, a list is one of
    sentences; None and what is empty are passed over. PROBLEMS, LEFT_OUT, PARAMETERS and DISAGREEMENT have places of
    their own.

    Raises:
        CorrectionError: a map in the folder cannot be read.
        ArtifactError: the page cannot be written.
    """
    from pointnetkl.correction.page import assembly  # draws: slow to import
    from pointnetkl.workflow import artifacts

    artifacts.write_bytes(folder / REPORT, assembly.page(folder, corrected, facts).encode())
