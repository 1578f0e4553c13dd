"""The table of loop closures, and the file in which a killed run keeps them."""

import dataclasses
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest

import closable
from closable import Toy
from pointnetkl.correction.result import CLOSURES
from pointnetkl.correction.solution import closures, verdict
from pointnetkl.slam.closing import survey
from pointnetkl.slam.closing.estimate import Closure, Tie
from pointnetkl.slam.closing.schemas import State
from pointnetkl.slam.closing.survey import Closed, Found
from pointnetkl.surveys.se2 import rotate

SETTINGS = survey.Settings()


@pytest.fixture(scope="module")
def hills() -> Toy:
    return closable.sail("hills")


@pytest.fixture(scope="module")
def closed(hills: Toy) -> Closed:
    """Return a survey with closures of every kind: accepted and refused, of rank 0 to 2, unmatched, on a reference."""
    base = hills.close(hills.drifted(0))
    found = list(base.found)
    first = found[0].closure
    assert first is not None
    found[0] = Found(found[0].source, found[0].targets, None, State.UNMATCHED)
    found[1] = dataclasses.replace(found[1], closure=cut_to(found[1].closure, 0))
    found[2] = dataclasses.replace(found[2], closure=cut_to(found[2].closure, 1))
    on_map = Tie.at(base.estimate.poses, 5, [], np.empty(0), np.array([1.0, 2.0]))
    sure = np.eye(2) / 0.5
    end = on_map.offset(base.estimate.poses)
    found.append(Found(5, [], Closure(on_map, sure, sure @ end, 0.01, end, 300), State.ACCEPTED))
    wrong = found[4].closure
    assert wrong is not None
    found[4] = dataclasses.replace(found[4], closure=dataclasses.replace(wrong, c=wrong.c + wrong.A @ [9.0, 9.0]))
    judged, estimate = survey.judge(base.navigation, found, SETTINGS)
    return dataclasses.replace(base, found=judged, estimate=estimate)


def cut_to(closure: Closure | None, rank: int) -> Closure:
    assert closure is not None
    return dataclasses.replace(closure, A=closure.A[:rank], c=closure.c[:rank])


def assert_same(found: Found, again: Found) -> None:
    assert (found.source, list(found.targets), found.state) == (again.source, list(again.targets), again.state)
    assert (found.closure is None) == (again.closure is None)
    if found.closure is None or again.closure is None:
        return
    for name in ("A", "c", "end"):
        np.testing.assert_array_equal(getattr(found.closure, name), getattr(again.closure, name), strict=True)
    assert found.closure.residual_variance == again.closure.residual_variance
    assert found.closure.points == again.closure.points
    for name in ("shares", "lever", "tied", "tied_source"):
        np.testing.assert_array_equal(getattr(found.closure.tie, name), getattr(again.closure.tie, name), strict=True)
    assert (found.closure.tie.source, list(found.closure.tie.targets)) == (found.source, list(found.targets))


def test_there_are_closures_of_every_kind(closed: Closed):
    ranks = {f.closure.rank for f in closed.found if f.closure is not None}
    assert ranks == {0, 1, 2}
    assert {State.ACCEPTED, State.UNMATCHED, State.FLAT} <= {f.state for f in closed.found}
    assert {State.PREDICTION, State.OUTVOTED} & {f.state for f in closed.found}
    assert any(not f.targets for f in closed.found)
    assert any(len(f.targets) > 1 for f in closed.found)


def test_closures_come_back_bit_for_bit(tmp_path: Path, closed: Closed):
    closures.save(tmp_path / "a.npz", closed.found, {"rounds": 3, "rates": {"scale_error": 0.1 + 0.2}})
    again, kept = closures.load(tmp_path / "a.npz")
    assert kept == {"rounds": 3, "rates": {"scale_error": 0.1 + 0.2}}
    assert len(again) == len(closed.found)
    for found, loaded in zip(closed.found, again, strict=True):
        assert_same(found, loaded)
    closures.save(tmp_path / "b.npz", again, kept)
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()


def test_loaded_closures_are_judged_alike(tmp_path: Path, closed: Closed):
    closures.save(tmp_path / "a.npz", closed.found, {})
    judged, estimate = survey.judge(closed.navigation, closures.load(tmp_path / "a.npz")[0], SETTINGS)
    np.testing.assert_array_equal(estimate.poses, closed.estimate.poses)
    assert [f.state for f in judged] == [f.state for f in closed.found]


@pytest.mark.parametrize("kept", [slice(0, 0), slice(0, 1), slice(-1, None)])
def test_none_and_single_ones_come_back_too(tmp_path: Path, closed: Closed, kept: slice):
    closures.save(tmp_path / "a.npz", closed.found[kept], {})
    again, _ = closures.load(tmp_path / "a.npz")
    for found, loaded in zip(closed.found[kept], again, strict=True):
        assert_same(found, loaded)


def test_the_table_has_the_columns_and_types_that_are_promised(hills: Toy, closed: Closed):
    table = closures.table(closed, closed.estimate.poses, hills.time_s, closable.SPACING_M)
    assert table.columns.tolist() == CLOSURES.names
    assert pa.Table.from_pandas(table, schema=CLOSURES, preserve_index=False).num_rows == len(closed.found)
    assert table["state"].tolist() == [str(f.state) for f in closed.found]
    assert table["targets"].tolist() == [" ".join(map(str, f.targets)) for f in closed.found]
    assert (table["weight"] == (table["state"] == "accepted")).all()


def test_what_a_refused_closure_lacks_is_null(hills: Toy, closed: Closed):
    table = closures.table(closed, closed.estimate.poses, hills.time_s, closable.SPACING_M)
    unmatched = table[table["state"] == "unmatched"]
    assert unmatched[["shift_x_m", "v_xx_m2", "residual_m", "sigmas_before", "left_out_m"]].isna().all(axis=None)
    assert (unmatched["rank"] == 0).all()
    flat = table[table["state"] == "flat"]
    assert flat[["v_xx_m2", "sigmas_before", "left_out_m"]].isna().all(axis=None)
    assert flat["residual_m"].notna().all()
    assert table.loc[table["rank"] < 2, ["v_xx_m2", "v_xy_m2", "v_yy_m2"]].isna().all(axis=None)
    assert table.loc[table["rank"] == 2, ["v_xx_m2", "v_xy_m2", "v_yy_m2"]].notna().all(axis=None)
    assert table.loc[table["state"] != "accepted", "left_out_m"].isna().all()
    assert table.loc[table["state"] == "accepted", "left_out_m"].notna().all()
    on_map = table[table["target"] == -1]
    assert on_map["target_time_s"].isna().all()
    assert on_map["targets"].eq("").all()


def test_each_number_is_what_its_name_says(hills: Toy, closed: Closed):
    poses, before = closed.estimate.poses, closed.navigation.poses
    table = closures.table(closed, poses, hills.time_s, closable.SPACING_M)
    for row, f in zip(table.itertuples(), closed.found, strict=True):
        assert row.time_s == hills.time_s[f.source]
        if f.closure is None or not f.closure.rank:
            continue
        tie = f.closure.tie
        assert [row.shift_x_m, row.shift_y_m] == pytest.approx(f.closure.end - tie.offset(before))
        assert row.sigmas_before == pytest.approx(np.linalg.norm(f.closure.residual(before)))
        assert row.sigmas_after == pytest.approx(np.linalg.norm(f.closure.residual(poses)))
        assert row.overlap_m2 == f.closure.points * closable.SPACING_M**2
        x, y, yaw = poses[f.source]
        assert [row.x_m, row.y_m] == pytest.approx(np.array([x, y]) + rotate(tie.lever, yaw))
        if row.rank == 2:
            V = np.array([[row.v_xx_m2, row.v_xy_m2], [row.v_xy_m2, row.v_yy_m2]])
            np.testing.assert_allclose(V @ f.closure.A.T @ f.closure.A, np.eye(2), atol=1e-9)


def test_the_target_is_the_one_with_most_of_the_overlap(hills: Toy, closed: Closed):
    table = closures.table(closed, closed.estimate.poses, hills.time_s, closable.SPACING_M)
    for row, f in zip(table.itertuples(), closed.found, strict=True):
        if f.closure is not None and len(f.targets):
            share = dict(zip(f.targets, f.closure.tie.shares, strict=True))
            assert share[row.target] == max(share.values())
            assert row.target_time_s == hills.time_s[row.target]


def test_left_out_is_in_metres(hills: Toy, closed: Closed):
    table = closures.table(closed, closed.estimate.poses, hills.time_s, closable.SPACING_M)
    left = [one.after for one in verdict.left_out(closed.navigation, closed.accepted)]
    metres = table.loc[table["state"] == "accepted", "left_out_m"].tolist()
    for number, closure, residual in zip(metres, closed.accepted, left, strict=True):
        if closure.rank == 2:
            assert number == pytest.approx(np.linalg.norm(np.linalg.solve(closure.A, residual)))
    assert max(metres) < 2


def test_accepted_closures_fit_better_after_than_before(hills: Toy, closed: Closed):
    table = closures.table(closed, closed.estimate.poses, hills.time_s, closable.SPACING_M)
    accepted = table[table["state"] == "accepted"]
    assert accepted["sigmas_after"].mean() < 0.7 * accepted["sigmas_before"].mean()


def test_a_survey_without_closures_has_a_table_without_rows(hills: Toy, closed: Closed):
    none = dataclasses.replace(closed, found=[])
    table = closures.table(none, closed.estimate.poses, hills.time_s, closable.SPACING_M)
    assert table.columns.tolist() == CLOSURES.names
    assert table.empty


def test_a_shift_of_the_estimate_is_the_same_in_axes_of_targets_that_turned(hills: Toy, closed: Closed):
    # navigation may be turned as a whole: where a source lies among its targets does not change by that
    f = next(f for f in closed.found if f.closure is not None and f.closure.rank == 2 and f.targets)
    assert f.closure is not None
    turned = closed.navigation.poses.copy()
    turned[:, :2], turned[:, 2] = rotate(turned[:, :2], 0.3), turned[:, 2] + 0.3
    assert f.closure.tie.offset(turned) == pytest.approx(f.closure.tie.offset(closed.navigation.poses), abs=1e-9)
