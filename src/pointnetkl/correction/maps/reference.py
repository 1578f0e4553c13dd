"""The coordinate system of maps and clouds, as text for their files."""

from pointnetkl.correction.result import CorrectionError

# of a survey whose place on the earth is not known
_LOCAL = 'LOCAL_CS["local",UNIT["metre",1],AXIS["east",EAST],AXIS["north",NORTH]]'


def wkt(crs: str) -> str:
    """Return the WKT of a CRS, of version 1 where it can be said in that; for "local" that of an engineering CRS.

    Raises:
        CorrectionError: the CRS is unknown.
    """
    from pyproj import CRS  # slow to import
    from pyproj.exceptions import CRSError

    if crs == "local":
        return _LOCAL
    try:
        known = CRS.from_user_input(crs)
    except CRSError as error:
        raise CorrectionError(f"the survey's crs {crs!r} is unknown; name another and run ingest again") from error
    try:
        return str(known.to_wkt("WKT1_GDAL"))
    except CRSError:
        return str(known.to_wkt())
