import tracemalloc

import numpy as np
import pandas as pd
import pytest

import corrected_soundings
import corrected_survey
from pointnetkl.correction.maps import thinning, tiles
from pointnetkl.correction.result import CorrectionError

NONE = corrected_soundings.without_pings(corrected_survey.corrected()).track


def test_a_typical_cell_holds_some_five_good_soundings() -> None:
    for per_m2 in (0.05, 1.0, 20.0, 800.0):
        side = np.sqrt(50_000 / per_m2)
        table = _points(50_000, side)
        cell = thinning.cell_size(thinning.draw([table], NONE), (5e5, 6e6))
        assert 2.0 <= per_m2 * cell**2 <= 12.5  # the next of 1, 2 and 5 is 2 to 2.5 times as large


def test_rejected_soundings_do_not_make_cells_smaller() -> None:
    table = _points(40_000, 200.0)  # one a square metre
    rejected = _points(400_000, 200.0, seed=1).assign(quality=np.int8(1))
    assert _cell(table) == _cell(pd.concat([table, rejected])) == 2.0


def test_dense_swaths_far_apart_are_judged_by_their_own_ground() -> None:
    swaths = [_points(20_000, 100.0, seed).assign(x_m=lambda t, s=seed: t["x_m"] + 5000.0 * s) for seed in range(3)]
    assert _cell(pd.concat(swaths)) == _cell(swaths[0]) == 2.0


def test_cells_are_not_smaller_than_a_centimetre() -> None:
    assert _cell(_points(10_000, 0.01)) == 0.01


def test_one_sounding_makes_a_map() -> None:
    assert _cell(_points(1, 1.0)) > 0


def test_a_map_of_few_soundings_in_a_wide_place_is_bounded() -> None:
    # a diagonal of 1,000 km, whose dense cells would make a bounding box of 10^12
    along = np.random.default_rng(0).uniform(0.0, 1e6, 100_000)
    table = _points(100_000, 1.0).assign(x_m=lambda t: t["x_m"] + along, y_m=lambda t: t["y_m"] + along)
    cell = _cell(table)
    assert (1e6 / cell) ** 2 <= thinning.LARGEST


def test_the_sample_does_not_depend_on_how_soundings_are_parted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(thinning, "_MOST", 3000)
    table = _points(40_000, 100.0)
    one, two = (
        thinning.draw((table.iloc[begin : begin + rows] for begin in range(0, len(table), rows)), NONE)
        for rows in (40_000, 999)
    )
    assert one.share == two.share < 0.1
    assert 1000 < len(one.before) <= 3000
    assert np.array_equal(one.before, two.before)


def test_a_sample_tells_the_same_cell_as_all_soundings(monkeypatch: pytest.MonkeyPatch) -> None:
    table = _points(60_000, 200.0)
    every = _cell(table)
    monkeypatch.setattr(thinning, "_MOST", 5000)
    assert _cell(table) == every


def test_the_reach_is_three_times_what_nearly_all_soundings_have() -> None:
    survey = corrected_survey.corrected()
    sample = thinning.draw([corrected_soundings.swaths(survey.track)], survey.track)
    assert sample.reach_m == pytest.approx(3 * corrected_soundings.HALF_M, rel=0.1)


def test_soundings_below_their_pings_are_believed() -> None:
    track = corrected_survey.corrected().track
    table = _points(len(track), 1.0).assign(ping=track["ping"], x_m=track["x_m"] + 1e-9, y_m=track["y_m"])
    assert len(thinning.draw([table], track).before) == len(track)


@pytest.mark.parametrize("origin", [(0.0, 0.0), (-3e5, -9e6), (5e5, 6e6)])
def test_tiles_hold_what_was_added_wherever_they_lie(origin: tuple[float, float]) -> None:
    rng = np.random.default_rng(0)
    places, depth = rng.uniform(-300, 300, (20_000, 2)) + origin, rng.normal(50, 1, 20_000)
    held = tiles.Tiles(2.0)
    for rows in np.array_split(np.arange(20_000), 7):
        held.add(places[rows], depth[rows])
    box = held.box
    assert box is not None
    image = held.window(box)
    assert image is not None
    cells = np.floor(places / 2.0).astype(int)
    truth = pd.Series(depth).groupby([box.row + box.rows - 1 - cells[:, 1], cells[:, 0] - box.column])
    row, column = np.array(truth.mean().index.tolist()).T
    np.testing.assert_allclose(image[:, row, column], [truth.mean(), truth.count(), truth.std()], rtol=1e-5)
    assert held.cells == np.isfinite(image[0]).sum() == len(row)


def test_a_window_beside_all_soundings_is_empty() -> None:
    held = tiles.Tiles(1.0)
    held.add(np.array([[10.0, 10.0]]), np.array([5.0]))
    assert held.window(tiles.Box(1000, 0, 512, 512)) is None


def test_soundings_in_order_or_not_give_the_same_map() -> None:
    rng = np.random.default_rng(0)
    places, depth = rng.uniform(0, 2000, (50_000, 2)), rng.normal(50, 1, 50_000)
    images = []
    for order in (np.argsort(places[:, 0]), rng.permutation(50_000)):
        held = tiles.Tiles(5.0)
        held.add(places[order], depth[order])
        images.append(held.window(tiles.Box(0, 0, 400, 400)))
    np.testing.assert_allclose(images[0], images[1], rtol=1e-5, atol=1e-6)


def test_memory_is_for_the_ground_and_not_for_its_bounding_box() -> None:
    along = np.linspace(0.0, 1e5, 100_000)
    tracemalloc.start()
    held = tiles.Tiles(1.0)
    held.add(np.column_stack([along, along]), np.full(len(along), 20.0))  # a box of 10^10 cells
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert held.cells >= 99_000
    assert peak < 400e6  # 1,563 tiles on the diagonal, and some beside


def test_a_map_with_too_many_cells_ends_in_one_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tiles, "MOST", 10)
    with pytest.raises(CorrectionError, match=r"cells of 0\.5 m takes more than 10 tiles"):
        tiles.Tiles(0.5).add(np.random.default_rng(0).uniform(0, 1000, (1000, 2)), np.zeros(1000))


def _cell(table: pd.DataFrame) -> float:
    return thinning.cell_size(thinning.draw([table], NONE), (5e5, 6e6))


def _points(count: int, side_m: float, seed: int = 0) -> pd.DataFrame:
    x, y = np.random.default_rng(seed).uniform(0.0, side_m, (2, count))
    return pd.DataFrame({"ping": -1, "beam": 0, "x_m": x, "y_m": y, "z_m": -20.0, "quality": np.int8(0)})
