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
            " ratio is ours over the paper's. spacing_m is the median distance of a point to its nearest neighbour.",
        ),
        shown["table_1"],
        {
            "swath": "A piece of the first training survey's swath, good soundings only (the paper's Fig. 2).",
            "canonical": "Normalised and voxelised submaps, all in one sphere (the paper's Fig. 3); at most 25,000"
            " points are drawn. Points away from the disc mean relief.",
        },
        (
            "Areas and counts of submaps are far below the paper's at every scale but the paper's own, because a"
            " smaller scale has fewer and smaller submaps. sigma_z can be compared better, though smaller submaps"
            " change it too.",
        ),
    )


def cleaning(shown: Blocks) -> Section:
    """Return the section of the tables of cleaning."""
    return Section(
        "Cleaning",
        (
            "All that is left out is counted here. pings_left_out are damaged, lack a position, time or heading, lie"
            " far off the track, or occur twice. reordered pings stand later in their file than they were taken, and"
            " are used. Soundings stay in the tables with a flag: rejected by the sonar or its operator, impossible, or"
            " outliers, which differ from the neighbouring beams by more than ingest.outliers allows and agree with no"
            " sounding of the neighbouring pings. Only valid soundings are used.",
            "A line ends at a gap (segment.max_gap_m), at a turn (segment.max_turn_rad, from smoothed positions because"
            " headings are noisy) and where a turn was not logged. on_turns counts pings on turns, in_ends pings at the"
            " ends of lines that are too short for a submap. gaps counts steps within a line that are too long, and"
            " missed_m is their length in all. alone counts valid soundings without a neighbour in their submap.",
        ),
        shown["cleaning"],
        notes=(
            "A gross error that two neighbours share (a school of fish, say) looks like a rock and stays. Look at what"
            " a survey's own editing has flagged before you trust it.",
        ),
    )
