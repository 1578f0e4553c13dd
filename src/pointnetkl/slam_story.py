"""The page's words on SLAM: what its tables and figures show, and what cannot be concluded from them."""

from collections.abc import Mapping, Sequence

from pointnetkl.page import Section
from pointnetkl.text_table import Block

Blocks = Mapping[str, Sequence[Block]]


def sections(shown: Blocks) -> list[Section]:
    """Return the page's sections on SLAM around the tables, by the stems of their files."""
    return [_benchmark(shown)]


def _benchmark(shown: Blocks) -> Section:
    return Section(
        "SLAM",
        (
            "Yaw noise corrupts the dead reckoning of each survey's graph; the graph is optimised with each method's Q"
            " on its loop closures. RMSE_xyz is over submap positions, not aligned. Map-to-map is the distance between"
            " overlapping submaps (root mean square over cells of their worst pair); a perfect map is not at 0, because"
            " soundings are apart. N_DR and N_LC count edges of dead reckoning and loop closures.",
        ),
        shown["table_4"],
        {
            "slam": "Error by method. Bars are 95 % intervals of the mean over repetitions.",
            "bathymetry": "Depth of the test surveys, submaps at their GT poses (the paper's Fig. 5).",
            "trajectories": "Repetition 0: GT, corrupted, solved with the covariances named. One scale per survey.",
        },
        (
            "GT is navigation optimised with the Monte Carlo covariances, as in the paper: it favours monte_carlo."
            " Where the truth is known (simulated surveys), rest conclusions on truth_rmse_xyz_m; the row gt"
            " tells how far GT itself is from it.",
            "All repetitions corrupt one and the same graph, whose loop closures were registered once:"
            " intervals are over the yaw noise alone and say nothing of another draw of the loop closures.",
        ),
    )
