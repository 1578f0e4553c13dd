"""The page's words on surveys: their sizes, and what was left out before they were cut."""

from pointnetkl.reporting.page import Section
from pointnetkl.reporting.text_table import Blocks


def sizes(shown: Blocks) -> Section:
    """Return the section of Table I."""
    return Section(
        "Surveys",
        (
            "Area is the union of the submaps' footprints. sigma_z is the standard deviation of z over all points once"
            " each submap is moved to zero mean and scaled into the unit sphere: small for flat or wide ground. The"
            " ratio is ours over the paper's. spacing_m is the median distance of a point to its nearest.",
        ),
        shown["table_1"],
        {
            "swath": "A piece of the first training survey's swath, good soundings only (the paper's Fig. 2).",
            "canonical": "Normalised and voxelised submaps, all in one sphere (the paper's Fig. 3); at most 25,000"
            " points are drawn. Points away from the disc mean relief.",
        },
        (
            "Areas and counts of submaps fall far below the paper's at every scale but the paper's own: a smaller"
            " scale has fewer and smaller submaps. sigma_z compares better, though smaller submaps change it too.",
        ),
    )


def cleaning(shown: Blocks) -> Section:
    """Return the section of the tables of cleaning."""
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
