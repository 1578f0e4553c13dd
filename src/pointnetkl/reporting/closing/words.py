"""The page's section on surveys closed from their own navigation."""

from collections.abc import Iterator

from pointnetkl.registration.covariance.catalogue import MAP, NAVIGATION
from pointnetkl.reporting.page import Section
from pointnetkl.reporting.text_table import Blocks, Numbers, cell


def section(shown: Blocks, closing: Numbers) -> Section:
    """Return the section around Table V."""
    return Section(
        "A survey corrected: closed from its own navigation (Table V)",
        (
            *_gains(closing),
            "The paper's protocol corrupts the yaw and gives dead reckoning 5 m an edge. Here nothing is corrupted: all"
            " poses have the joint covariance of the vehicle's drift (study.surveys.<survey>.navigation), and loop"
            " closures are searched from navigation. Run 0 is the recorded navigation; where the truth is known, other"
            " drifts are drawn about it (close.drifts), with the submaps' points as they are.",
            "map registers to the most probable place and hands the graph the ground's pull alone. pair is the same"
            " from GICP's ends. The others weight those of GICP by the covariance of the source submap: their ends were"
            " found from poses that pair had corrected, which is the best case for them. Every method passes the same"
            " gates. They close loops on flat ground too, to which labels give a Q, and map and pair none. split has a"
            " covariance only for submaps that close a loop in stage graph.",
            "A name that ends in believed_<k> is told that drift is k times as large as it is (close.believed).",
        ),
        shown["table_5"],
        {
            "closing": "Method map on the recorded navigation: the track with its loop closures, and the error of each"
            " submap's place against the truth (how far it moved, where the truth is not known)."
        },
    )


def _gains(closing: Numbers) -> Iterator[str]:
    gains = [
        f"{survey} from {cell(methods[NAVIGATION]['as_it_is_m'], 3)} m to {cell(methods[MAP]['as_it_is_m'], 3)} m"
        f" ({methods[MAP]['worse']} of {methods[MAP]['runs']} runs worse)"
        for survey, methods in closing.items()
        if methods[MAP]["worse"] is not None
    ]
    if gains:
        yield f"What closing its loops by MAP does to the error of a survey's positions: {'; '.join(gains)}."
