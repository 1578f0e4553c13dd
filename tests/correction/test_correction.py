"""A survey corrected from raw files to a folder: what is moved, what is left, and what a killed run leaves."""

import errno
import json
import os
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import rasterio
import yaml

import closable
import raw_survey
from pointnetkl import correction
from pointnetkl.correction import Corrected, CorrectionError, Inputs, Settings, delivery
from pointnetkl.correction.preparation import inputs
from pointnetkl.correction.result import CLOSURES, TRACK
from pointnetkl.correction.solution import closing
from pointnetkl.surveys.survey import POINTS, SUBMAPS
from pointnetkl.workflow.errors import PointNetKLError
from raw_survey import BEGIN_S, EAST, NORTH, Plan, Raw

PLAN = Plan(drift_m=1.5)
APART = Plan(lines=2, apart_m=400.0)  # no overlap
FULL = OSError(errno.ENOSPC, "No space left on device")


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """Write no products but a file, as most truths here are not of them."""
    monkeypatch.setattr(delivery, "write", lambda folder, *_: (folder / "parameters.yaml").write_text("x"))


@pytest.fixture(scope="module")
def drifted(tmp_path_factory: pytest.TempPathFactory) -> Raw:
    return raw_survey.write(tmp_path_factory.mktemp("drifted") / "raw", PLAN)


@pytest.fixture(scope="module")
def whole(drifted: Raw) -> tuple[Corrected, Path]:
    """Return the drifted survey corrected, with all products."""
    out = drifted.folder.parent / "out"
    return correction.correct(Inputs([drifted.folder]), out, Settings()), out


def rms(raw: Raw, corrected: Corrected, share: float = 1.0) -> float:
    errors = raw.error(corrected.track, corrected.origin, share)
    return float(np.sqrt((errors**2).sum(axis=1).mean()))


def files(folder: Path) -> dict[str, bytes]:
    return {str(file.relative_to(folder)): file.read_bytes() for file in folder.rglob("*") if file.is_file()}


def assert_left_as_it_was(corrected: Corrected) -> None:
    assert not corrected.verdict.applied
    assert corrected.verdict.sentence.startswith("Left as it was")
    assert "nan" not in corrected.verdict.sentence
    assert corrected.rms_moved_m == 0.0
    assert not corrected.track[["moved_x_m", "moved_y_m", "moved_yaw_rad"]].to_numpy().any()


# --- what is moved, and what is not


def test_a_drift_is_corrected(drifted: Raw, whole: tuple[Corrected, Path]):
    corrected, _ = whole
    assert corrected.verdict.applied
    assert rms(drifted, corrected) < 0.2 * rms(drifted, corrected, 0.0)
    assert corrected.track.columns.tolist() == TRACK.names
    assert corrected.closures.columns.tolist() == CLOSURES.names
    assert corrected.verdict.disagreement_after_m < corrected.verdict.disagreement_before_m


def test_sigmas_hold_the_errors_of_a_drift(drifted: Raw, whole: tuple[Corrected, Path]):
    track, origin = whole[0].track, whole[0].origin
    for share, prefix in ((0.0, "before_"), (1.0, "")):
        variance = track[[f"{prefix}var_xx_m2", f"{prefix}var_yy_m2"]].to_numpy()
        squares = drifted.error(track, origin, share)[50:] ** 2 / variance[50:]
        assert 0.02 < squares.mean() < 4


def test_products_are_of_the_corrected_track(drifted: Raw, whole: tuple[Corrected, Path]):
    corrected, out = whole
    track = pd.read_csv(out / "track.csv", comment="#")
    x = corrected.track["x_m"] + corrected.track["moved_x_m"] + corrected.origin[0]
    assert track["x_m"].to_numpy() == pytest.approx(x.to_numpy(), abs=2e-3)
    before, after = (rasterio.open(out / f"map_{name}.tif").read(1) for name in ("before", "after"))
    assert before.shape != after.shape or not np.array_equal(before, after)
    known = yaml.safe_load((out / "parameters.yaml").read_text())
    assert known["verdict"]["sentence"] == corrected.verdict.sentence
    assert "report.html" in os.listdir(out)


def test_a_survey_without_drift_is_left_as_it_was_to_the_last_bit(tmp_path: Path):
    raw = raw_survey.write(tmp_path / "raw", Plan())
    corrected = correction.correct(Inputs([raw.folder]), tmp_path / "out", Settings())
    assert_left_as_it_was(corrected)
    assert len(corrected.closures) > 5
    before, after = (rasterio.open(tmp_path / "out" / f"map_{name}.tif").read(1) for name in ("before", "after"))
    np.testing.assert_array_equal(before, after)


@pytest.mark.parametrize(("name", "jitter_m"), [("gnss", 0.1), ("usbl", 0.0), ("dead-reckoning", 0.1)])
def test_navigation_that_is_right_is_left_as_it_was_whatever_it_is(
    tmp_path: Path, name: str, jitter_m: float, quick: None
):
    raw = raw_survey.write(tmp_path / "raw", Plan(lines=3, jitter_m=jitter_m))
    corrected = correction.correct(Inputs([raw.folder]), tmp_path / "out", Settings(navigation=name))
    if corrected.verdict.applied:
        assert rms(raw, corrected) < rms(raw, corrected, 0.0) + 0.05  # by chance, and a twentieth of a spacing
    else:
        assert_left_as_it_was(corrected)


@pytest.mark.parametrize(
    ("plan", "why"),
    [
        (replace(PLAN, seabed=raw_survey.flat), "none could be used"),
        (Plan(lines=1), "no part of the survey returns"),
        (replace(APART, drift_m=1.5), "no part of the survey returns"),
        (Plan(lines=2, line_m=4.0, step_m=1.0), "cannot be cut"),
    ],
    ids=["flat", "one line", "no overlap", "too short"],
)
def test_what_cannot_be_corrected_is_left_as_it_was_and_says_why(tmp_path: Path, plan: Plan, why: str):
    raw = raw_survey.write(tmp_path / "raw", plan)
    corrected = correction.correct(Inputs([raw.folder]), tmp_path / "out", Settings())
    assert_left_as_it_was(corrected)
    assert why in corrected.verdict.sentence
    assert "study.surveys" not in corrected.verdict.sentence
    assert (tmp_path / "out" / "report.html").is_file()
    assert (tmp_path / "out" / "map_after.tif").is_file()


def test_points_without_pings_are_mapped_and_left_as_they_were(tmp_path: Path):
    x, y = np.meshgrid(np.arange(0, 60.0), np.arange(0, 60.0))
    z = raw_survey.hills(x, y)
    np.savetxt(tmp_path / "points.xyz", np.stack([x + 5e5, y + 6e6, z], -1).reshape(-1, 3), "%.2f")
    corrected = correction.correct(Inputs([tmp_path / "points.xyz"]), tmp_path / "out", Settings())
    assert corrected.kind == POINTS
    assert_left_as_it_was(corrected)
    assert "points without pings" in corrected.verdict.sentence
    assert (tmp_path / "out" / "map_after.tif").is_file()


def test_two_vehicles_at_once_are_told_apart_in_a_sentence(tmp_path: Path, quick: None):
    raw = raw_survey.at_once(tmp_path / "raw", Plan(lines=2))
    try:
        corrected = correction.correct(Inputs([raw.folder]), tmp_path / "out", Settings())
    except PointNetKLError as error:
        sentence = str(error)
    else:
        assert_left_as_it_was(corrected)
        sentence = corrected.verdict.sentence
    assert "\n" not in sentence
    assert "study.surveys" not in sentence
    # each by itself is a survey
    correction.correct(Inputs([raw.files[0]]), tmp_path / "first", Settings())


def test_submaps_that_another_program_has_posed_are_corrected(tmp_path: Path):
    toy = closable.sail("hills")
    navigation = toy.drifted(0)
    for k, (T, cloud) in enumerate(zip(navigation, toy.clouds, strict=True)):
        half = np.arctan2(T[1, 0], T[0, 0]) / 2
        pose = f"{T[0, 3]:.4f} {T[1, 3]:.4f} {T[2, 3]:.4f} {np.cos(half):.9f} 0 0 {np.sin(half):.9f}"
        head = (
            f"VERSION .7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH {len(cloud)}\nHEIGHT 1\n"
            f"VIEWPOINT {pose}\nPOINTS {len(cloud)}\nDATA binary\n"
        )
        (tmp_path / "raw").mkdir(exist_ok=True)
        (tmp_path / "raw" / f"submap_{k}.pcd").write_bytes(head.encode() + cloud.astype("<f4").tobytes())
    corrected = correction.correct(Inputs([tmp_path / "raw"]), tmp_path / "out", Settings())
    assert corrected.kind == SUBMAPS
    assert corrected.submaps is not None
    assert len(corrected.submaps.number) == len(corrected.track) == 12
    assert (corrected.closures["rank"] > 0).sum() >= 4
    if corrected.verdict.applied:
        relative = [T[4:, :2, 3] - T[0, :2, 3] for T in (corrected.submaps.before, corrected.submaps.after, toy.truth)]
        before, after = (np.linalg.norm(T - relative[2]) for T in relative[:2])
        assert after < before
    else:
        assert_left_as_it_was(corrected)


def test_two_heads_are_corrected_like_one(tmp_path: Path, quick: None):
    found = []
    for heads in (1, 2):
        raw = raw_survey.write(tmp_path / f"raw_{heads}", replace(PLAN, heads=heads, on_earth=True))
        corrected = correction.correct(Inputs([raw.folder]), tmp_path / f"out_{heads}", Settings())
        assert corrected.submaps is not None
        found.append((corrected.verdict.applied, len(corrected.submaps.number), rms(raw, corrected)))
    assert found[0][:2] == found[1][:2]
    assert found[0][2] == pytest.approx(found[1][2], abs=0.05)


def test_an_ingested_survey_is_corrected_like_its_raw_files(
    tmp_path: Path, drifted: Raw, whole: tuple[Corrected, Path], quick: None
):
    (tmp_path / "survey").mkdir()
    inputs.ingest(Inputs([drifted.folder]), "survey", Settings(), tmp_path / "survey")
    corrected = correction.correct(Inputs([tmp_path / "survey"]), tmp_path / "out", Settings())
    pd.testing.assert_frame_equal(corrected.track, whole[0].track)
    assert sorted(file.name for file in (tmp_path / "survey").iterdir()) == ["pings.parquet", "soundings.parquet"]


# --- what is known beforehand


def fixes(path: Path, raw: Raw, every: int, sigma_m: float, wrong: int | None = None) -> Path:
    """Write true places of the vehicle as fixes, of which one may be 10 km off."""
    table = raw.truth.iloc[::every].reset_index(drop=True).assign(sigma_m=sigma_m)
    if wrong is not None:
        table.loc[wrong, "x_m"] += 10_000.0
    table.to_csv(path, index=False)
    return path


@pytest.mark.parametrize("name", ["dead-reckoning", "gnss"])
def test_a_fix_moves_the_whole_track_there_and_the_maps_with_it(tmp_path: Path, name: str):
    raw = raw_survey.write(tmp_path / "raw", raw_survey.shifted(APART, 1.0, -0.6))
    source = Inputs([raw.folder], fixes=fixes(tmp_path / "fix.csv", raw, 60, 0.1))
    corrected = correction.correct(source, tmp_path / "out", Settings(navigation=name))
    assert corrected.verdict.applied
    assert rms(raw, corrected) < 0.35 * rms(raw, corrected, 0.0)
    before, after = (rasterio.open(tmp_path / "out" / f"map_{name}.tif") for name in ("before", "after"))
    assert not (before.shape == after.shape and np.array_equal(before.read(1), after.read(1)))
    text = " ".join(
        str(yaml.safe_load((tmp_path / "out" / "parameters.yaml").read_text())["verdict"]["sentence"]).split()
    )
    assert text.startswith("Corrected")


def test_a_single_fix_far_from_a_sure_track_does_not_pass_in_silence(tmp_path: Path, quick: None):
    raw = raw_survey.write(tmp_path / "raw", APART)
    table = pd.DataFrame({"time_s": [BEGIN_S + 90], "sigma_m": [0.1], "x_m": [EAST + 180 + 500], "y_m": [NORTH]})
    table.to_csv(tmp_path / "fix.csv", index=False)
    corrected = correction.correct(
        Inputs([raw.folder], fixes=tmp_path / "fix.csv"), tmp_path / "out", Settings(navigation="gnss")
    )
    if corrected.verdict.applied:
        assert "given" in corrected.verdict.sentence
    else:
        assert_left_as_it_was(corrected)


@pytest.mark.parametrize(("name", "wrong"), [("dead-reckoning", None), ("dead-reckoning", 0), ("usbl", 7)])
def test_fixes_hold_a_track_and_one_that_is_10_km_off_does_not_move_it(
    tmp_path: Path, drifted: Raw, name: str, wrong: int | None, quick: None
):
    source = Inputs([drifted.folder], fixes=fixes(tmp_path / "fix.csv", drifted, 60, 0.5, wrong))
    corrected = correction.correct(source, tmp_path / "out", Settings(navigation=name))
    assert corrected.verdict.applied
    assert rms(drifted, corrected) < 0.3 * rms(drifted, corrected, 0.0)


def test_held_files_do_not_move_and_what_lies_between_is_corrected(tmp_path: Path, quick: None):
    raw = raw_survey.write(tmp_path / "raw", Plan(lines=5, drift_m=4.0, returns=True))
    held = ["line_0.parquet", "line_4.parquet"]
    corrected = correction.correct(Inputs([raw.folder], held=held), tmp_path / "out", Settings())
    moved = corrected.track[["moved_x_m", "moved_y_m"]].abs().max(axis=1).groupby(corrected.track["file"]).max()
    assert corrected.verdict.applied
    assert moved[held].max() < 0.06
    assert moved["line_2.parquet"] > 3
    assert rms(raw, corrected) < 0.1 * rms(raw, corrected, 0.0)


@pytest.mark.parametrize("name", ["dead-reckoning", "usbl"])
def test_a_reference_takes_out_a_constant_shift_which_closures_cannot_see(tmp_path: Path, name: str, quick: None):
    plan = raw_survey.shifted(Plan(), 4.0, -3.0)
    raw = raw_survey.write(tmp_path / "raw", plan)
    grid = raw_survey.grid(tmp_path / "known.tif", plan)
    corrected = correction.correct(Inputs([raw.folder], reference=grid), tmp_path / "out", Settings(navigation=name))
    assert corrected.verdict.applied
    assert rms(raw, corrected) < 0.06 * rms(raw, corrected, 0.0)
    assert (corrected.closures["target"] == -1).sum() >= 10


def test_without_a_reference_a_constant_shift_stays(tmp_path: Path, quick: None):
    raw = raw_survey.write(tmp_path / "raw", raw_survey.shifted(Plan(lines=3), 4.0, -3.0))
    corrected = correction.correct(Inputs([raw.folder]), tmp_path / "out", Settings())
    assert rms(raw, corrected) == pytest.approx(5.0, abs=0.1)


def test_a_reference_takes_out_a_drift_too(tmp_path: Path, drifted: Raw, quick: None):
    grid = raw_survey.grid(tmp_path / "known.tif", PLAN)
    corrected = correction.correct(Inputs([drifted.folder], reference=grid), tmp_path / "out", Settings())
    assert corrected.verdict.applied
    assert rms(drifted, corrected) < 0.05 * rms(drifted, corrected, 0.0)


def test_a_reference_of_another_level_is_as_good(tmp_path: Path, quick: None):
    plan = raw_survey.shifted(Plan(lines=2), 2.0, -3.0)
    raw = raw_survey.write(tmp_path / "raw", plan)
    deeper = replace(plan, seabed=lambda x, y: raw_survey.hills(x, y) - 7.0)
    grid = raw_survey.grid(tmp_path / "known.tif", deeper)
    corrected = correction.correct(Inputs([raw.folder], reference=grid), tmp_path / "out", Settings(navigation="usbl"))
    assert rms(raw, corrected) < 0.15 * rms(raw, corrected, 0.0)


@pytest.mark.parametrize(("first", "second"), [(0, 1), (1, 0)])
def test_a_given_tie_moves_the_second_file_against_the_first(tmp_path: Path, first: int, second: int, quick: None):
    raw = raw_survey.write(tmp_path / "raw", Plan(lines=2, seabed=raw_survey.flat))
    middles = [BEGIN_S + 90 + 300 * k for k in (first, second)]
    names = " ".join(f"./line_{k}.parquet" for k in (first, second))
    axes = "0.05 1 0 0 0.05 0 1 0 1 0 0 1"
    (tmp_path / "ties.txt").write_text(f"TIE {names} 2 {middles[0]} {middles[1]} 3.0 -2.0 0.0\nCOV {axes}\n")
    source = Inputs([raw.folder], ties=tmp_path / "ties.txt")
    corrected = correction.correct(source, tmp_path / "out", Settings(navigation="usbl"))
    assert corrected.verdict.applied
    moved = corrected.track.set_index("time_s").loc[middles, ["moved_x_m", "moved_y_m"]].to_numpy()
    # of true east and north; the map is turned by 1.3 degrees
    assert moved[1] - moved[0] == pytest.approx([3.0, -2.0], abs=0.25)


def test_an_smrmsg_beside_an_sbet_makes_navigation_as_sure_as_it_says(tmp_path: Path, quick: None):
    raw = raw_survey.write(tmp_path / "raw", replace(PLAN, on_earth=True))
    raw_survey.sbet(raw.folder / "sbet_track.out", raw)
    raw_survey.smrmsg(raw.folder / "smrmsg_track.out", 0.06, 3.0)
    corrected = correction.correct(Inputs([raw.folder]), tmp_path / "out", Settings())
    assert_left_as_it_was(corrected)
    assert rms(raw, corrected) < 0.01  # the SBET has the true track
    sigma = np.sqrt(corrected.track[["before_var_xx_m2", "var_xx_m2", "var_yy_m2"]].to_numpy())
    assert sigma.min() > 0.05
    assert sigma.max() < 0.15


def test_files_of_a_folder_may_be_given_one_by_one(tmp_path: Path, quick: None):
    raw = raw_survey.write(tmp_path / "raw", replace(PLAN, on_earth=True))
    raw_survey.sbet(raw.folder / "sbet_track.out", raw)
    raw_survey.smrmsg(raw.folder / "smrmsg_track.out", 0.06, 3.0)
    one, other = (
        correction.correct(Inputs(paths), tmp_path / name, Settings())
        for name, paths in (("a", [raw.folder]), ("b", sorted(raw.folder.iterdir())))
    )
    pd.testing.assert_frame_equal(one.track, other.track)


# --- the folder


@pytest.mark.slow
def test_the_bytes_do_not_depend_on_workers(
    tmp_path: Path, drifted: Raw, whole: tuple[Corrected, Path], monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(closing, "_SEVERAL", 2)
    monkeypatch.setattr(closing, "_CHUNK", 4)
    monkeypatch.setenv("POINTNETKL_WORKERS", "2")
    correction.correct(Inputs([drifted.folder]), tmp_path / "out", Settings())
    assert files(tmp_path / "out") == files(whole[1])  # of one worker


@pytest.mark.parametrize("error", [KeyboardInterrupt(), pytest.param(FULL, marks=pytest.mark.slow)])
def test_a_killed_run_ends_in_the_same_bytes_and_does_not_begin_anew(
    tmp_path: Path,
    drifted: Raw,
    whole: tuple[Corrected, Path],
    error: BaseException,
    monkeypatch: pytest.MonkeyPatch,
):
    def killed(*arguments: object) -> None:
        write(*arguments)  # type: ignore[arg-type]
        raise error

    write, out = delivery.write, tmp_path / "out"
    monkeypatch.setattr(delivery, "write", killed)
    with pytest.raises((KeyboardInterrupt, CorrectionError)):
        correction.correct(Inputs([drifted.folder]), out, Settings())
    assert os.listdir(tmp_path) == [".out.partial"]
    monkeypatch.setattr(delivery, "write", write)

    def never(*_: object) -> None:
        raise AssertionError("what an earlier run has finished is made again")

    monkeypatch.setattr(inputs, "ingest", never)
    monkeypatch.setattr(closing, "close", never)
    correction.correct(Inputs([drifted.folder]), out, Settings())
    assert files(out) == files(whole[1])
    assert os.listdir(tmp_path) == ["out"]


@pytest.mark.parametrize("step", ["survey", "closures"])
def test_a_run_killed_in_an_earlier_step_ends_in_the_same_track(
    tmp_path: Path, drifted: Raw, whole: tuple[Corrected, Path], step: str, quick: None, monkeypatch: pytest.MonkeyPatch
):
    from pointnetkl.correction.scratch import Scratch

    make = Scratch.step

    def killed(self: Scratch, name: str, fill: Callable[[Path], None]) -> Path:
        def half(folder: Path) -> None:
            fill(folder)
            raise KeyboardInterrupt

        return make(self, name, half if name == step else fill)

    monkeypatch.setattr(Scratch, "step", killed)
    with pytest.raises(KeyboardInterrupt):
        correction.correct(Inputs([drifted.folder]), tmp_path / "out", Settings())
    monkeypatch.setattr(Scratch, "step", make)
    corrected = correction.correct(Inputs([drifted.folder]), tmp_path / "out", Settings())
    pd.testing.assert_frame_equal(corrected.track, whole[0].track)
    assert os.listdir(tmp_path) == ["out"]


def killed_run(raw: Raw, out: Path, settings: Settings, monkeypatch: pytest.MonkeyPatch) -> None:
    def killed(*_: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(delivery, "write", killed)
        with pytest.raises(KeyboardInterrupt):
            correction.correct(Inputs([raw.folder]), out, settings)


@pytest.mark.parametrize("change", ["settings", "held", "touched"])
def test_with_other_settings_or_files_all_begins_anew(
    tmp_path: Path, change: str, quick: None, monkeypatch: pytest.MonkeyPatch
):
    raw = raw_survey.write(tmp_path / "raw", replace(PLAN, lines=2))
    killed_run(raw, tmp_path / "out", Settings(), monkeypatch)
    ingested = []
    ingest = inputs.ingest
    monkeypatch.setattr(inputs, "ingest", lambda *rest: (ingested.append(1), ingest(*rest)))
    if change == "touched":
        os.utime(raw.files[0], (1, 1))
    correction.correct(
        Inputs([raw.folder], held=["line_0.parquet"] if change == "held" else []),
        tmp_path / "out",
        Settings(overlap_points=151) if change == "settings" else Settings(),
    )
    assert ingested == [1]


def test_a_folder_that_is_there_is_refused_and_replaced_if_asked(tmp_path: Path, quick: None):
    raw = raw_survey.write(tmp_path / "raw", replace(PLAN, lines=2))
    (tmp_path / "out").mkdir()
    for name in ("parameters.yaml", "report.html"):
        (tmp_path / "out" / name).write_text("")
    with pytest.raises(CorrectionError, match=r"out: is there already; give --replace"):
        correction.correct(Inputs([raw.folder]), tmp_path / "out", Settings())
    assert sorted(os.listdir(tmp_path)) == ["out", "raw"]
    assert sorted(os.listdir(tmp_path / "out")) == ["parameters.yaml", "report.html"]
    correction.correct(Inputs([raw.folder]), tmp_path / "out", Settings(), replace=True)
    assert os.listdir(tmp_path / "out") == ["parameters.yaml"]
    assert sorted(os.listdir(tmp_path)) == ["out", "raw"]


def test_an_empty_folder_may_be_filled(tmp_path: Path, quick: None):
    raw = raw_survey.write(tmp_path / "raw", replace(PLAN, lines=2))
    (tmp_path / "out").mkdir()
    correction.correct(Inputs([raw.folder]), tmp_path / "out", Settings())
    assert os.listdir(tmp_path / "out") == ["parameters.yaml"]


@pytest.mark.parametrize("where", ["raw", ".", "raw/out", "raw/line_0.parquet"])
@pytest.mark.parametrize("replaced", [True, False])
def test_raw_files_are_never_replaced(tmp_path: Path, where: str, replaced: bool, quick: None):
    raw = raw_survey.write(tmp_path / "all" / "raw", replace(PLAN, lines=2))
    before = files(tmp_path / "all")
    with pytest.raises(CorrectionError) as ended:
        correction.correct(Inputs([raw.folder]), tmp_path / "all" / where, Settings(), replaced)
    assert "\n" not in str(ended.value)
    assert files(tmp_path / "all") == before


def test_raw_files_behind_a_link_are_never_replaced(tmp_path: Path, quick: None):
    raw = raw_survey.write(tmp_path / "all" / "raw", replace(PLAN, lines=2))
    (tmp_path / "link").symlink_to(raw.folder)
    with pytest.raises(CorrectionError):
        correction.correct(Inputs([tmp_path / "link"]), raw.folder, Settings(), replace=True)
    assert all(file.is_file() for file in raw.files)


def test_what_is_known_beside_it_is_never_replaced(tmp_path: Path, drifted: Raw, quick: None):
    (tmp_path / "out").mkdir()
    path = fixes(tmp_path / "out" / "fix.csv", drifted, 60, 1.0)
    with pytest.raises(CorrectionError):
        correction.correct(Inputs([drifted.folder], fixes=path), tmp_path / "out", Settings(), replace=True)
    assert path.is_file()


LATE = [pytest.param(name, marks=pytest.mark.slow) for name in ("soundings.laz", "report.html")]
WRITTEN = ["soundings.parquet", "points.f32", "pings.parquet", "cut.json", "closures.npz", *LATE]


@pytest.mark.parametrize("name", WRITTEN)
def test_a_full_disk_is_one_sentence_and_no_folder(
    tmp_path: Path, drifted: Raw, name: str, monkeypatch: pytest.MonkeyPatch
):
    write, opened, reached = Path.write_bytes, Path.open, []

    def write_bytes(path: Path, content: bytes) -> int:
        if name in path.name:
            reached.append(path)
            raise FULL
        return write(path, content)

    def open_(path: Path, *rest: object, **named: object) -> object:
        if name in path.name and "w" in "".join(map(str, rest)):
            reached.append(path)
            return opened(Path("/dev/full"), *rest, **named)
        return opened(path, *rest, **named)

    def group(*_: object, **__: object) -> None:
        reached.append(name)
        raise FULL

    monkeypatch.setattr(Path, "write_bytes", write_bytes)
    monkeypatch.setattr(Path, "open", open_)
    if name == "soundings.parquet":
        monkeypatch.setattr("pyarrow.parquet.ParquetWriter.write_table", group)
    with pytest.raises(PointNetKLError, match=r"No space left on device|requested and|cannot be written") as ended:
        correction.correct(Inputs([drifted.folder]), tmp_path / "out", Settings())
    assert reached
    assert "\n" not in str(ended.value)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("given", ["sources", "fixes", "reference", "ties"])
def test_a_path_that_is_missing_is_said_before_anything_is_read(tmp_path: Path, drifted: Raw, given: str):
    gone = tmp_path / "gone"
    source = Inputs([gone]) if given == "sources" else Inputs([drifted.folder], **{given: gone})
    with pytest.raises(CorrectionError, match=r"gone: is missing; check the path"):
        correction.correct(source, tmp_path / "out", Settings())
    assert os.listdir(tmp_path) == []


def test_nothing_to_read_is_one_sentence_and_leaves_nothing(tmp_path: Path):
    (tmp_path / "raw").mkdir()
    with pytest.raises(PointNetKLError, match="has no raw files") as ended:
        correction.correct(Inputs([tmp_path / "raw"]), tmp_path / "out", Settings())
    assert "\n" not in str(ended.value)
    assert os.listdir(tmp_path) == ["raw"]


def test_a_survey_without_a_good_sounding_is_one_sentence(tmp_path: Path):
    raw = raw_survey.write(tmp_path / "raw", Plan(lines=2, line_m=40.0))
    for file in raw.files:
        table = pd.read_parquet(file)
        raw_survey.generic_files.parquet(file, table.assign(quality=1), raw_survey.CRS)
    with pytest.raises(PointNetKLError) as ended:
        correction.correct(Inputs([raw.folder]), tmp_path / "out", Settings())
    assert re.search("good|quality", str(ended.value))
    assert not (tmp_path / "out").exists()


def test_the_key_is_json_and_hides_nothing_that_matters(drifted: Raw):
    keys = [
        json.dumps(source.key(settings), sort_keys=True, default=str)
        for source, settings in (
            (Inputs([drifted.folder]), Settings()),
            (Inputs([drifted.folder], held=["a"]), Settings()),
            (Inputs([drifted.folder]), Settings(seed=2)),
            (Inputs([drifted.folder], rates={"mine": closable.DRIFT}), Settings()),
            (Inputs([drifted.folder], fixes=drifted.files[0]), Settings()),
            (Inputs(drifted.files[:2]), Settings()),
        )
    ]
    assert len(set(keys)) == len(keys)


def test_a_folder_that_is_no_result_is_not_replaced(tmp_path: Path):
    raw = raw_survey.write(tmp_path / "raw", Plan())
    out = tmp_path / "mine"
    out.mkdir()
    (out / "thesis.txt").write_text("all of it")
    with pytest.raises(CorrectionError, match="is no result of an earlier correction"):
        correction.correct(Inputs([raw.folder]), out, Settings(), replace=True)
    assert (out / "thesis.txt").read_text() == "all of it"
