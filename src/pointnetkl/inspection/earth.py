"""Places on the earth and names of CRS, for people to read: an unknown CRS is no error here."""

from typing import Any

import numpy as np

from pointnetkl.readers import projection


def place(crs: str, x: float, y: float) -> dict[str, Any]:
    """Return the longitude and latitude of a place in a CRS; an empty dictionary if the CRS is unknown."""
    if (system := _crs(crs)) is None:
        return {}
    from pyproj import Transformer
    from pyproj.exceptions import ProjError

    try:
        longitude, latitude = Transformer.from_crs(system, projection.GEOGRAPHIC, always_xy=True).transform(x, y)
    except ProjError:
        return {}
    return {"longitude_deg": longitude, "latitude_deg": latitude} if np.isfinite(longitude + latitude) else {}


def name(crs: str) -> str:
    """Return the code and name of a CRS, or its name if it has no code."""
    if crs == projection.LOCAL:
        return "none: metres east and north of an unknown place"
    if (system := _crs(crs)) is None:
        return shortened(crs)
    return f"{crs} ({system.name})" if len(crs) < 20 else str(system.name)


def shortened(words: str, most: int = 60) -> str:
    """Return a text on one line, cut to `most` characters."""
    words = " ".join(words.split())
    return words if len(words) <= most else f"{words[: most - 3]}..."


def is_metric(crs: str) -> bool:
    """Whether a CRS is projected, in metres."""
    system = _crs(crs)
    return (
        system is not None and system.is_projected and all(axis.unit_name == "metre" for axis in system.axis_info[:2])
    )


def _crs(crs: str) -> Any:
    """Return a CRS; None if it is unknown."""
    if crs in ("", projection.LOCAL):
        return None
    from pyproj import CRS  # slow to import, and local surveys do not need it
    from pyproj.exceptions import CRSError

    try:
        return CRS.from_user_input(crs)
    except CRSError:  # any text may stand as the CRS of a projected survey
        return None
