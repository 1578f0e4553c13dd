"""Where on the earth a place in a CRS is, and what a CRS is called: both for people, so that nothing is refused."""

from typing import Any

import numpy as np

from pointnetkl.readers import projection


def place(crs: str, x: float, y: float) -> dict[str, Any]:
    """Return the longitude and latitude of a place in a CRS, nothing where that is unknown."""
    if (known := _crs(crs)) is None:
        return {}
    from pyproj import Transformer
    from pyproj.exceptions import ProjError

    try:
        longitude, latitude = Transformer.from_crs(known, projection.GEOGRAPHIC, always_xy=True).transform(x, y)
    except ProjError:
        return {}
    return {"longitude_deg": longitude, "latitude_deg": latitude} if np.isfinite(longitude + latitude) else {}


def name(crs: str) -> str:
    """Return what a CRS is called: its code and name, or its name where it has no code."""
    if crs == projection.LOCAL:
        return "none: metres east and north of an unknown place"
    if (known := _crs(crs)) is None:
        return shortened(crs)
    return f"{crs} ({known.name})" if len(crs) < 20 else str(known.name)


def shortened(words: str, most: int = 60) -> str:
    """Return words on one line, cut where there are too many."""
    words = " ".join(words.split())
    return words if len(words) <= most else f"{words[: most - 3]}..."


def is_metric(crs: str) -> bool:
    """Whether a CRS is projected, in metres."""
    known = _crs(crs)
    return known is not None and known.is_projected and all(axis.unit_name == "metre" for axis in known.axis_info[:2])


def _crs(crs: str) -> Any:
    """Return a CRS; None where it is not known."""
    if crs in ("", projection.LOCAL):
        return None
    from pyproj import CRS  # takes its time, and local surveys do without
    from pyproj.exceptions import CRSError

    try:
        return CRS.from_user_input(crs)
    except CRSError:  # a survey's own words, which nothing has needed until here
        return None
