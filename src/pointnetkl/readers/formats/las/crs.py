"""The coordinate system of a LAS file: by its WKT record, else by its GeoTIFF keys."""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pointnetkl.readers import projection
from pointnetkl.readers.formats.las.header import Header, LasError

_USER, _WKT, _KEYS = "LASF_Projection", 2112, 34735
_GEOGRAPHIC, _PROJECTED, _LINEAR_UNIT, _VERTICAL, _VERTICAL_UNIT = 2048, 3072, 3076, 4096, 4099  # GeoTIFF keys
_WKT_BEGINS = re.compile(
    r"(PROJ(CS|(ECTED)?CRS)|GEO(GCS|GCRS|GRAPHICCRS|DCRS|DETICCRS)|COMP(D_CS|OUNDCRS)|BOUNDCRS|LOCAL_CS|ENG\w*CRS)\s*\[",
    re.IGNORECASE,
)
_UNITS_M = {9001: 1.0, 9002: 0.3048, 9003: 1200 / 3937}  # EPSG: metre, foot, US survey foot
_HEIGHTS = {  # vertical codes of GeoTIFF 1.0
    **dict.fromkeys(range(5001, 5034), "height above an ellipsoid"),
    **{5101: "ODN height", 5102: "NGVD29 height", 5103: "NAVD88 height"},
    **{5104: "Yellow Sea height", 5105: "Baltic height", 5106: "Caspian height"},
}
_SURE = 70  # percent of agreement between a WKT and an EPSG code


@dataclass(frozen=True)
class Reference:
    """The coordinate system of a file."""

    crs: str  # EPSG:n where it has a code, else WKT; projection.LOCAL where the file has none
    vertical: str  # name of the vertical CRS, empty where there is none
    unit_m: float  # metres per unit of z
    down: bool | None  # whether z counts down; None: unknown


def reference(path: Path, header: Header) -> Reference:
    """Return the coordinate system of a file.

    Raises:
        LasError: the file's CRS is neither a map in metres nor longitude and latitude.
    """
    text = header.records.get((_USER, _WKT), b"").split(b"\0", 1)[0].decode("utf-8", "replace").strip()
    keys = _keys(header.records.get((_USER, _KEYS), b""))
    code = keys.get(_PROJECTED) or keys.get(_GEOGRAPHIC)
    crs = _parsed(text) if text else _parsed(code) if code and code < 32767 else None
    if crs is None:
        if text or code or keys.get(_LINEAR_UNIT, 9001) != 9001:
            raise LasError(
                f"{path}: its coordinate system {(text or f'with GeoTIFF keys {keys}')[:80]!r} is not known;"
                " write the file again with an EPSG code"
            )
        return Reference(projection.LOCAL, *_height_from_keys(keys))
    level, height = _parts(crs)
    if height is not None:
        return Reference(_horizontal(path, level), *_height(height))
    if len(level.axis_info) > 2:
        unit_m = level.axis_info[2].unit_conversion_factor or 1.0
        return Reference(_horizontal(path, level.to_2d()), f"height above the ellipsoid of {level.name}", unit_m, False)
    return Reference(_horizontal(path, level), *_height_from_keys(keys))


def _keys(record: bytes) -> dict[int, int]:
    """Return the GeoTIFF keys whose value is a code; the others refer to texts and parameters."""
    words = np.frombuffer(record, "<u2", len(record) // 8 * 4).reshape(-1, 4)[1:]
    return {int(key): int(value) for key, place, _, value in words if place == 0}


def _parsed(definition: str | int) -> Any:
    """Return the CRS of a WKT or an EPSG code, None if there is none."""
    from pyproj import CRS  # slow to import
    from pyproj.exceptions import CRSError

    if isinstance(definition, str) and not _WKT_BEGINS.match(definition):
        return None  # pyproj would look it up by name, which takes a second
    try:
        return CRS.from_wkt(definition) if isinstance(definition, str) else CRS.from_epsg(definition)
    except CRSError:
        return None


def _parts(crs: Any) -> tuple[Any, Any]:
    """Return the horizontal and the vertical part of a CRS; the latter is None if there is none."""
    if crs.is_bound:
        crs = crs.source_crs
    level, height = (crs.sub_crs_list[:2]) if crs.is_compound else (crs, None)
    return (level.source_crs if level.is_bound else level), height


def _height(crs: Any) -> tuple[str, float, bool | None]:
    """Return a vertical CRS's name, its metres per unit, and whether z counts down."""
    axis = (crs.source_crs if crs.is_bound else crs).axis_info[0]
    return crs.name, axis.unit_conversion_factor or 1.0, {"up": False, "down": True}.get(axis.direction.lower())


def _height_from_keys(keys: dict[int, int]) -> tuple[str, float, bool | None]:
    """Return the same by the GeoTIFF keys; the key of the unit has precedence."""
    code = keys.get(_VERTICAL, 0)
    crs = _parsed(code) if 1023 < code < 32767 else None
    name, unit_m, down = "", 1.0, None
    if crs is not None and crs.is_vertical:
        name, unit_m, down = _height(crs)
    elif code in _HEIGHTS:
        name, down = _HEIGHTS[code], False
    return name, _UNITS_M.get(keys.get(_VERTICAL_UNIT, 0), unit_m), down


def _horizontal(path: Path, crs: Any) -> str:
    code = crs.to_epsg(min_confidence=_SURE)
    if crs.is_geographic:
        if code != 4326 and "WGS" not in crs.name.upper():
            raise LasError(f"{path}: is in longitude and latitude on {crs.name}; reproject it to UTM or EPSG:4326")
        return projection.GEOGRAPHIC
    if not crs.is_projected or any(axis.unit_name != "metre" for axis in crs.axis_info):
        unit = crs.axis_info[0].unit_name if crs.axis_info else "nothing"
        raise LasError(f"{path}: its CRS {crs.name} is in {unit}, must be in metres; reproject it, for example to UTM")
    return f"EPSG:{code}" if code else str(crs.to_wkt())
