"""Where a survey's map frame lies on the earth, as its pings' file says."""

from pathlib import Path

from pointnetkl.workflow import artifacts
from pointnetkl.workflow.errors import PointNetKLError


class MapFrameError(PointNetKLError):
    """A survey does not say where it is."""


def read(path: Path) -> tuple[tuple[float, float], str]:
    """Return the origin of the map frame, easting and northing in metres, and the CRS of these; it may be "local".

    Raises:
        MapFrameError: the file of pings has neither.
        ArtifactError: it is missing or damaged.
    """
    found = artifacts.table_metadata(path)
    if len(found.get("origin", ())) != 2 or "crs" not in found:
        raise MapFrameError(f"{path}: must name the crs and origin of its map frame; run dvc repro ingest")
    east, north = found["origin"]
    return (float(east), float(north)), str(found["crs"])
