"""The page's words on cleaning: what was left out of each survey before it was cut, and why."""

from collections.abc import Mapping, Sequence

from pointnetkl.reporting.page import Section
from pointnetkl.reporting.text_table import Block


def section(shown: Mapping[str, Sequence[Block]]) -> Section:
    """Return the section of the tables of cleaning, of the tables by the stems of their files."""
    return Section(
        "Cleaning",
        (
            "Nothing is left out in silence. pings_left_out: damaged, without a place, time or heading, far off the"
            " track, or there twice; reordered: later in their file than in time, and used. Soundings stay in the"
            " tables with a flag: rejected by the sonar or its operator; impossible; outliers, which differ from the"
            " beams about them by ingest.outliers and have no like in the pings beside. Only valid ones are used.",
            "A line ends at a gap (segment.max_gap_m), at a turn (segment.max_turn_rad; by smoothed positions, for"
            " headings are noisy) and where a turn was not logged. on_turns and in_ends are pings: of turns, and of"
            " ends of lines too short for a submap. gaps are steps too long within a line, missed_m their metres"
            " in all. alone: valid soundings that stand alone in their submap.",
        ),
        shown["cleaning"],
        notes=(
            "A gross error that two others beside it share (a school of fish, say) looks like a rock, and stays: look"
            " at what a survey's own editing has flagged before trusting it.",
        ),
    )
