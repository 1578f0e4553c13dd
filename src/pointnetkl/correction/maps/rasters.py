"""Maps as cloud-optimised GeoTIFF: depth, density and uncertainty before and after, and the difference of depth."""

import contextlib
import math
import shutil
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from pointnetkl.correction.maps import reference
from pointnetkl.correction.maps.thinning import LARGEST
from pointnetkl.correction.maps.tiles import Box, Tiles
from pointnetkl.correction.result import Corrected, CorrectionError
from pointnetkl.workflow.artifacts import one_line

BEFORE, AFTER, DIFFERENCE = "map_before.tif", "map_after.tif", "difference.tif"
BANDS = {  # of the maps: unit and meaning by name
    "Depth": ("m", "mean depth of the good soundings of a cell, positive down"),
    "Density": ("soundings", "good soundings of a cell"),
    "Uncertainty": ("m", "standard deviation (1 sigma) of the good soundings of a cell about their mean"),
}
CHANGE = {"Difference": ("m", "depth after less depth before the correction, positive: deeper")}

_BLOCK = 512  # cells of a block, along each axis
_CACHE_MB = 64
_RAW = {"driver": "GTiff", "tiled": True, "blockxsize": _BLOCK, "blockysize": _BLOCK, "bigtiff": "IF_SAFER"}
_CLOUD = {"driver": "COG", "compress": "DEFLATE", "predictor": "YES", "blocksize": _BLOCK, "bigtiff": "IF_SAFER"}


def write(folder: Path, before: Tiles, after: Tiles, corrected: Corrected) -> float:
    """Write the maps and their difference, all on one grid, and return the rms of the difference in metres.

    The grid is aligned to multiples of the cell in the CRS. Where the track was left as it was, `after` is `before`.
    Equal input gives equal bytes. The rms is NaN where the maps share no cell.

    Raises:
        CorrectionError: the CRS is unknown, the maps are too large, or a file cannot be written.
    """
    import rasterio  # slow to import

    box = _common(before, after)
    layout = _layout(box, before.cell_m, corrected)
    with _one_sentence(folder), rasterio.Env(GDAL_CACHEMAX=_CACHE_MB):
        names = [BEFORE, DIFFERENCE] if after is before else [BEFORE, AFTER, DIFFERENCE]
        rms = _write_blocks(folder, names, box, (before, after), layout)
        for name in names:
            _to_cloud(folder / name, CHANGE if name == DIFFERENCE else BANDS)
        if after is before:
            shutil.copyfile(folder / BEFORE, folder / AFTER)
    return rms


def _common(before: Tiles, after: Tiles) -> Box:
    boxes = [tiles.box for tiles in (before, after)]
    held = np.array([(box.column, box.row, box.column + box.columns, box.row + box.rows) for box in boxes if box])
    if not len(held):
        raise CorrectionError(
            "no good sounding is near its ping, and there is nothing to map; check the survey's poses"
        )
    (column, row), (right, top) = held[:, :2].min(axis=0).tolist(), held[:, 2:].max(axis=0).tolist()
    box = Box(column, row, right - column, top - row)
    if box.columns * box.rows > LARGEST:
        raise CorrectionError(
            f"a map with cells of {before.cell_m:g} m has {box.columns} x {box.rows} cells, and may have {LARGEST};"
            " give larger cells"
        )
    return box


def _layout(box: Box, cell_m: float, corrected: Corrected) -> dict[str, Any]:
    import rasterio

    west, north = box.column * cell_m, (box.row + box.rows) * cell_m
    return {
        "crs": rasterio.CRS.from_wkt(reference.wkt(corrected.crs)),
        "transform": rasterio.Affine(cell_m, 0.0, west, 0.0, -cell_m, north),
        "width": box.columns,
        "height": box.rows,
        "dtype": "float32",
        "nodata": math.nan,
        "tags": {"vertical_datum": "; ".join(corrected.vertical) or "unknown", "survey": corrected.name},
    }


def _write_blocks(
    folder: Path, names: list[str], box: Box, maps: tuple[Tiles, Tiles], layout: Mapping[str, Any]
) -> float:
    """Write all maps block by block to files that the cloud-optimised ones are made of; return the rms difference."""
    squares, cells = 0.0, 0
    with contextlib.ExitStack() as stack:
        files = [stack.enter_context(_raw(_beside(folder / name), name, layout)) for name in names]
        for window, part in _blocks(box):
            before = maps[0].window(part)
            after = before if maps[0] is maps[1] else maps[1].window(part)
            if before is not None and after is not None:
                change = after[0] - before[0]
                files[-1].write(change[None], window=window)
                squares += float(np.nansum(change.astype(np.float64) ** 2))
                cells += int(np.isfinite(change).sum())
            for file, image in zip(files[:-1], (before, after), strict=False):
                if image is not None:
                    file.write(image, window=window)
    return math.sqrt(squares / cells) if cells else math.nan


def _raw(path: Path, name: str, layout: Mapping[str, Any]) -> Any:
    import rasterio

    bands = CHANGE if name == DIFFERENCE else BANDS
    profile = {key: value for key, value in layout.items() if key != "tags"}
    file = rasterio.open(path, "w", count=len(bands), sparse_ok=True, **profile, **_RAW)
    units = "; ".join(f"{band} ({unit}): {meaning}" for band, (unit, meaning) in bands.items())
    file.update_tags(**layout["tags"], bands=units)
    for number, (band, (unit, meaning)) in enumerate(bands.items(), 1):
        file.set_band_description(number, band)
        file.set_band_unit(number, unit)
        file.update_tags(number, meaning=meaning)
    return file


def _blocks(box: Box) -> Iterator[tuple[Any, Box]]:
    """Yield the windows of a raster, and the cells that each shows."""
    from rasterio.windows import Window

    for top in range(0, box.rows, _BLOCK):
        rows = min(_BLOCK, box.rows - top)
        for left in range(0, box.columns, _BLOCK):
            columns = min(_BLOCK, box.columns - left)
            row = box.row + box.rows - top - rows
            yield Window(left, top, columns, rows), Box(box.column + left, row, columns, rows)


def _to_cloud(path: Path, bands: Mapping[str, Any]) -> None:
    import rasterio
    from rasterio import shutil as rasters

    rasters.copy(_beside(path), path, sparse_ok="YES", overview_resampling="AVERAGE", **_CLOUD)
    with rasterio.open(path) as file, rasterio.open(_beside(path)) as raw:
        for band in range(1, len(bands) + 1):
            if file.checksum(band) != raw.checksum(band):  # GDAL does not tell of every block that it could not write
                raise OSError(0, "what was written reads otherwise; is the disk full?")
    _beside(path).unlink()


def _beside(path: Path) -> Path:
    return path.with_name(f".{path.name}.raw")


@contextlib.contextmanager
def _one_sentence(folder: Path) -> Iterator[None]:
    from rasterio._err import CPLE_BaseError  # what copying raises is not among rasterio.errors
    from rasterio.errors import RasterioError

    try:
        yield
    except (RasterioError, CPLE_BaseError, OSError) as error:
        first: Any = error.__cause__ or error  # what rasterio raises refers to what GDAL said
        cause = getattr(first, "strerror", "") or one_line(first)
        raise CorrectionError(f"{folder}: the maps cannot be written ({cause}); is the disk full?") from error
