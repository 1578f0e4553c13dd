import dataclasses
import hashlib
import itertools
import struct
from pathlib import Path

import numpy as np
import pytest
import rasterio
import rasterio.shutil
from rasterio._err import CPLE_AppDefinedError
from rasterio.windows import Window

import corrected_soundings
import corrected_survey
from corrected_soundings import band
from pointnetkl.correction import maps
from pointnetkl.correction.maps import rasters
from pointnetkl.correction.result import CorrectionError

SURVEY = corrected_survey.corrected()
SOUNDINGS = corrected_soundings.swaths(SURVEY.track)
MAPS = (rasters.BEFORE, rasters.AFTER, rasters.DIFFERENCE)
GOOD = SOUNDINGS[SOUNDINGS["quality"] == 0]


def test_the_map_of_a_plane_is_the_plane(tmp_path: Path) -> None:
    corrected_soundings.write(tmp_path, SURVEY, SOUNDINGS)
    depth, profile = band(tmp_path / rasters.BEFORE, "Depth")
    east, north = corrected_soundings.centres(profile)
    true = -corrected_soundings.plane(east - SURVEY.origin[0], north - SURVEY.origin[1])
    held = np.isfinite(depth)
    assert held.sum() > 3000
    assert np.abs(depth - true)[held].max() < 0.05  # a cell's slope over its width


def test_cells_hold_count_mean_and_standard_deviation_of_their_good_soundings(tmp_path: Path) -> None:
    numbers = corrected_soundings.write(tmp_path, SURVEY, SOUNDINGS)
    places = maps.renavigated(GOOD, SURVEY.track)
    for name, where in ((rasters.BEFORE, GOOD[["x_m", "y_m"]].to_numpy()), (rasters.AFTER, places)):
        _, profile = band(tmp_path / name, "Depth")
        rows, columns = _cells(where, profile)
        cells = (-GOOD["z_m"]).groupby([rows, columns])
        for image, truth in (("Depth", cells.mean()), ("Density", cells.count()), ("Uncertainty", cells.std())):
            values, _ = band(tmp_path / name, image)
            expected = np.full(values.shape, np.nan)
            expected[tuple(np.array(truth.index.tolist()).T)] = truth
            np.testing.assert_allclose(values, expected, rtol=1e-6, atol=1e-6)
    assert numbers.cells_after == len(cells)


def test_the_uncertainty_of_a_deep_flat_cell_keeps_its_digits(tmp_path: Path) -> None:
    depth = 4000.0 + np.random.default_rng(0).normal(0.0, 0.001, len(SOUNDINGS))
    corrected_soundings.write(tmp_path, SURVEY, SOUNDINGS.assign(z_m=-depth), 1e4)
    uncertainty, _ = band(tmp_path / rasters.BEFORE, "Uncertainty")
    assert np.nanmax(uncertainty) == pytest.approx(0.001, rel=0.05)


def test_the_difference_is_depth_after_less_depth_before_where_both_are(tmp_path: Path) -> None:
    numbers = corrected_soundings.write(tmp_path, SURVEY, SOUNDINGS)
    before, after = (band(tmp_path / name, "Depth")[0] for name in MAPS[:2])
    change, _ = band(tmp_path / rasters.DIFFERENCE, "Difference")
    np.testing.assert_array_equal(change, after - before)
    assert numbers.rms_difference_m == pytest.approx(np.sqrt(np.nanmean(change.astype(float) ** 2)))
    assert (numbers.cells_before, numbers.cells_after) == tuple(np.isfinite(image).sum() for image in (before, after))


def test_a_shift_of_whole_cells_shifts_the_map_by_them(tmp_path: Path) -> None:
    corrected_soundings.write(tmp_path, corrected_soundings.moved_by(SURVEY, x=6.0), SOUNDINGS)
    before, after = (band(tmp_path / name, "Depth")[0] for name in MAPS[:2])
    np.testing.assert_allclose(after[:, 3:], before[:, :-3], atol=1e-5)


def test_a_track_left_as_it_was_gives_equal_maps_and_no_difference(tmp_path: Path) -> None:
    numbers = corrected_soundings.write(tmp_path, corrected_survey.corrected(applied=False), SOUNDINGS)
    assert (tmp_path / rasters.BEFORE).read_bytes() == (tmp_path / rasters.AFTER).read_bytes()
    change, _ = band(tmp_path / rasters.DIFFERENCE, "Difference")
    assert set(change[np.isfinite(change)]) == {0.0}
    assert numbers.rms_difference_m == 0.0
    assert np.isfinite(change).sum() == numbers.cells_before == numbers.cells_after


@pytest.mark.parametrize("cell_m", [0.5, 2.0])  # with overviews and without
def test_files_are_cloud_optimised(tmp_path: Path, cell_m: float) -> None:
    corrected_soundings.write(tmp_path, SURVEY, SOUNDINGS, cell_m)
    for name in MAPS:
        content = (tmp_path / name).read_bytes()
        assert b"LAYOUT=IFDS_BEFORE_DATA" in content[:200]
        headers, data = _directories(content)
        assert len(headers) == (2 if cell_m == 0.5 else 1)
        assert headers == sorted(headers)
        assert max(headers) < min(at for tiles in data for at in tiles)
        assert all(min(one) > max(next_) for one, next_ in itertools.pairwise(data))  # overviews first


def test_files_state_crs_vertical_datum_bands_and_units(tmp_path: Path) -> None:
    corrected_soundings.write(tmp_path, SURVEY, SOUNDINGS)
    for name, bands in zip(MAPS, [rasters.BANDS, rasters.BANDS, rasters.CHANGE], strict=True):
        with rasterio.open(tmp_path / name) as file:
            assert file.descriptions == tuple(bands)
            assert file.units == tuple(unit for unit, _ in bands.values())
            assert [file.tags(number)["meaning"] for number in file.indexes] == [text for _, text in bands.values()]
            assert file.tags()["vertical_datum"] == "water line"
            assert file.crs.to_epsg() == 32633
            assert file.dtypes == ("float32",) * len(bands)
            assert np.isnan(file.nodata)
    assert tuple(rasters.BANDS) == ("Depth", "Density", "Uncertainty")


def test_a_local_survey_has_an_engineering_crs_and_a_datum_that_is_not_known(tmp_path: Path) -> None:
    survey = dataclasses.replace(corrected_survey.corrected("local"), vertical=[])
    corrected_soundings.write(tmp_path, survey, SOUNDINGS)
    with rasterio.open(tmp_path / rasters.AFTER) as file:
        assert file.crs.wkt.startswith('LOCAL_CS["local"')
        assert file.tags()["vertical_datum"] == "unknown"


@pytest.mark.parametrize("cell_m", [0.5, 3.0])
def test_all_files_lie_on_one_grid_aligned_to_multiples_of_the_cell(tmp_path: Path, cell_m: float) -> None:
    corrected_soundings.write(tmp_path, SURVEY, SOUNDINGS, cell_m)
    profiles = [band(tmp_path / name, next(iter(file_bands)))[1] for name, file_bands in _with_bands()]
    assert len({(profile["transform"], profile["width"], profile["height"]) for profile in profiles}) == 1
    corner = np.array([profiles[0]["transform"].c, profiles[0]["transform"].f])
    np.testing.assert_allclose(corner / cell_m, np.round(corner / cell_m), atol=1e-9)


def test_a_stray_sounding_is_left_out_of_maps_and_counted(tmp_path: Path) -> None:
    astray = SOUNDINGS.copy()
    astray.loc[[100, 3000], "x_m"] = [9e6, -4e5]
    numbers = corrected_soundings.write(tmp_path, SURVEY, astray)
    assert (numbers.left_out, numbers.good, numbers.soundings) == (2, len(GOOD), len(SOUNDINGS))
    density, profile = band(tmp_path / rasters.AFTER, "Density")
    assert max(profile["width"], profile["height"]) < 300
    assert np.nansum(density) == len(GOOD) - 2


def test_points_without_pings_are_mapped_but_for_strays(tmp_path: Path) -> None:
    points = SOUNDINGS.assign(ping=-1, beam=0)
    points.loc[100, "y_m"] = 5e6
    numbers = corrected_soundings.write(tmp_path, corrected_soundings.without_pings(SURVEY), points)
    assert numbers.left_out == 1
    assert np.nansum(band(tmp_path / rasters.BEFORE, "Density")[0]) == len(GOOD) - 1


def test_two_runs_give_the_same_bytes_however_soundings_are_parted(tmp_path: Path) -> None:
    for name, rows in (("one", 5000), ("two", 777)):
        maps.write(tmp_path / name, SURVEY, corrected_soundings.in_parts(SOUNDINGS, rows), None)
    one, two = (_digests(tmp_path / name) for name in ("one", "two"))
    assert sorted(one) == sorted([*MAPS, maps.CLOUD, maps.TABLE])
    assert one == two


def test_a_raster_too_large_ends_in_one_sentence(tmp_path: Path) -> None:
    with pytest.raises(CorrectionError, match="give larger cells"):
        corrected_soundings.write(tmp_path, SURVEY, SOUNDINGS, 0.002)
    assert not list(tmp_path.iterdir())


def test_an_unknown_crs_ends_in_one_sentence(tmp_path: Path) -> None:
    with pytest.raises(CorrectionError, match="is unknown"):
        corrected_soundings.write(tmp_path, dataclasses.replace(SURVEY, crs="EPSG:1"), SOUNDINGS)
    assert not list(tmp_path.iterdir())


def test_what_gdal_says_of_a_failure_is_in_the_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object, **__: object) -> None:
        raise CPLE_AppDefinedError(3, 1, "write error at scanline 7")

    monkeypatch.setattr(rasterio.shutil, "copy", fail)
    with pytest.raises(CorrectionError, match=r"maps cannot be written .*at scanline 7"):
        corrected_soundings.write(tmp_path, SURVEY, SOUNDINGS)
    assert not list(tmp_path.iterdir())


def test_a_map_that_lost_a_block_unsaid_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    copy = rasterio.shutil.copy

    def lossy(source: Path, target: Path, **options: object) -> None:
        copy(source, target, **options)
        with rasterio.open(target, "r+", IGNORE_COG_LAYOUT_BREAK="YES") as file:
            file.write(np.full((1, 20, 20), np.nan, np.float32), [1], window=Window(20, 20, 20, 20))

    monkeypatch.setattr(rasterio.shutil, "copy", lossy)
    with pytest.raises(CorrectionError, match="reads otherwise"):
        corrected_soundings.write(tmp_path, SURVEY, SOUNDINGS)
    assert not list(tmp_path.iterdir())


def _cells(places: np.ndarray, profile: dict[str, object]) -> tuple[np.ndarray, np.ndarray]:
    to_map = profile["transform"]
    east, north = (places + SURVEY.origin).T
    return np.floor((to_map.f - north) / to_map.a).astype(int), np.floor((east - to_map.c) / to_map.a).astype(int)


def _with_bands() -> list[tuple[str, dict[str, tuple[str, str]]]]:
    return list(zip(MAPS, [rasters.BANDS, rasters.BANDS, rasters.CHANGE], strict=True))


def _digests(folder: Path) -> dict[str, str]:
    return {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in folder.iterdir()}


def _directories(content: bytes) -> tuple[list[int], list[list[int]]]:
    """Return where the directories of a TIFF are, and where the tiles of each are, by hand."""
    assert content[:4] == b"II*\0"
    at, headers, data = struct.unpack("<I", content[4:8])[0], [], []
    while at:
        headers.append(at)
        (count,) = struct.unpack_from("<H", content, at)
        entries = [struct.unpack_from("<HHII", content, at + 2 + 12 * index) for index in range(count)]
        (tiles,) = [entry for entry in entries if entry[0] == 324]  # TileOffsets
        assert tiles[1] == 4
        data.append([tiles[3]] if tiles[2] == 1 else list(struct.unpack_from(f"<{tiles[2]}I", content, tiles[3])))
        data[-1] = [offset for offset in data[-1] if offset]  # 0: a tile without data
        (at,) = struct.unpack_from("<I", content, at + 2 + 12 * count)
    return headers, data
