"""Table V: surveys closed from their own navigation."""

from pointnetkl.reporting import text_table
from pointnetkl.reporting.text_table import Block, Numbers
from pointnetkl.slam.closing.schemas import ERRORS

_QUALITY = ("pose_nees", "joined_95", "variance_factor", "worse", "runs")
_COLUMNS = ("survey", "simulated", "method", *ERRORS, *_QUALITY, "closures", "accepted", "flat")


def every(numbers: Numbers, datasets: Numbers) -> dict[str, list[Block]]:
    """Return the table by the stem of its files."""
    caption = (
        "Surveys closed from their own navigation, nothing corrupted. Root mean square errors against the truth in the"
        " plane, metres: as it is, after the best shift and turn, and of the submaps that return to mapped ground on"
        " the ground they return to (joined). pose_nees of x and y (1 is right; drawn drifts have the rates that are"
        " believed, the recorded one has its own). joined_95: share of those submaps' errors on that ground within the"
        " 95 % ellipse of the poses' own covariance (of navigation: how right closures' starts are told)."
        " variance_factor of the closures at navigation's poses: 1 where drift and closures are as sure as they say."
        " worse: runs that end over 2 % worse than navigation. closures: found, accepted, and flat (their ground says"
        " nothing), means; the rest is refused."
    )
    return {"table_5": [text_table.block(caption, list(text_table.by_method(numbers["closing"], datasets)), _COLUMNS)]}
