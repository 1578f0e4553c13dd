"""A small study's artifacts as the stages leave them, made up: a seabed of waves, labels that follow its slopes."""

import itertools
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
import yaml

from pointnetkl.registration import monte_carlo
from pointnetkl.registration.covariance import catalogue, label_table, table
from pointnetkl.slam.benchmark import protocol
from pointnetkl.slam.benchmark import schemas as slam_schemas
from pointnetkl.slam.closing import schemas as closing_schemas
from pointnetkl.slam.closures import schemas as closure_schemas
from pointnetkl.slam.consistency import consistency_map
from pointnetkl.slam.consistency import schemas as consistency_schemas
from pointnetkl.slam.consistency.consistency_map import Cells
from pointnetkl.slam.robust import schemas as robust_schemas
from pointnetkl.surveys import pose, submap, survey, voxel
from pointnetkl.workflow import artifacts

LENGTH_M, SPACING_M, LINES, ALONG = 60.0, 4.0, 3, 6
TRAIN, TEST = ("baltic", "borno_1"), ("borno_8", "mine")
MODELS = ("pointnetkl", "network")
METHODS = ("monte_carlo", "constant", "naive_gicp", "constant_train", "structure_tensor", *MODELS)
CRS = "EPSG:32632"
REPETITIONS, DRAWS, HELD_OUT = 4, 3, 40
TRUE = ("truth_rmse_xyz_m", "truth_rmse_se2_m", "truth_relative_m")  # of slam_schemas.ROWS, that figures need
_DROPPED = {"soundings of bad quality": 10, "soundings standing alone": 4, "pings on turns": 25, "pings in them": 6}
_WENT = {"relative_error": 0.2, "mean_x_m": 0.1, "converged_share": 0.9, "main_basin_share": 0.8, "iterations_mean": 7}


@dataclass(frozen=True)
class Fake:
    """One made-up survey: its poses (submap.POSES), clouds in submap frames, and labels (k, 2, 2)."""

    name: str
    poses: pd.DataFrame
    clouds: list[np.ndarray]
    q: np.ndarray


def write(root: Path) -> None:
    """Write data/, models/, reports/ and params.yaml of a study with two training and two test surveys.

    `mine` is a user's own survey: not simulated, without truth or loop closures.
    """
    for name in (*TRAIN, *TEST):
        fake = _survey(name)
        _write_survey(root / "data", fake)
        _write_labels(root / "data", fake)
        if name in TEST:
            _write_variations(root / "data", fake)
            _write_test(root, fake)
    _write_training(root)
    (root / "params.yaml").write_text(yaml.safe_dump(_parameters()))


def _parameters() -> dict[str, object]:
    lines = {
        name: {
            "group": _group(name),
            "raw": f"data/raw/{name}",
            "truth": "data/none",
            "submap_length_m": 60,
            "point_spacing_m": 4,
            "label_runs": 50,
        }
        for name in (*TRAIN, *TEST)
    }
    study = {"train": {n: lines[n] for n in TRAIN}, "test": {n: lines[n] for n in TEST}, "surveys": lines}
    report = {"seed": 9, "kl_floor_m2": 0.01, "cell_factor": 2.0, "block_submaps": 3}
    report["terrain_classes"] = {"flat_slope": 0.004, "rugged_slope": 0.02}
    return {"study": {"scale": "smoke", "models": list(MODELS), **study}, "report": report}


def _simulation(name: str) -> dict[str, object]:
    """Return what a survey claims to be simulated from: hills; and in borno_8 a wall, beside its third line."""
    relief = {"height_m": 0.0, "length_m": 500.0, "flat": 0.5, "stretch": 1.0, "azimuth_deg": 0.0}
    terrain: dict[str, object] = {"depth_m": 80.0, "patch_m": 200.0, "relief": relief}
    terrain["hills"] = {"slope": [0.0001, 0.2], "length_m": 150.0}
    terrain["texture"] = {"slope": [1e-4, 1e-3], "length_m": 9.0}
    if name == "borno_8":
        terrain["wall"] = {"height_m": 30.0, "width_m": 30.0, "azimuth_deg": 0.0, "offset_m": 165.0}
    layout = {"lines": 3, "line_length_m": 360.0, "line_spacing_m": 50.0, "start_jitter_m": 0.0, "repeat_m": 0.0}
    place = {"crs": CRS, "centre_m": [0.0, 0.0], "layout": {**layout, "azimuth_deg": 0.0}, "altitude_m": 20.0}
    settings = {
        "seed": len(name),
        "vehicle": "hugin",
        "grid": "data/none",
        "ping_spacing_m": 2.0,
        "beam_spacing_m": 2.0,
    }
    return {**settings, **place, "terrain": terrain}


def _group(name: str) -> str:
    return "train" if name in TRAIN else "test"


def _products(data: Path, name: str) -> Path:
    return data / _group(name) / name


def _rng(name: str) -> np.random.Generator:
    return np.random.default_rng(list(name.encode()))


def seabed(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return the made-up depth (z, metres) at places in the map frame."""
    return -80 + 6 * np.sin(x / 70) * np.cos(y / 45) + 1.5 * np.sin((x + y) / 11)


def _survey(name: str) -> Fake:
    rng = _rng(name)
    rows, clouds = [], []
    for i in range(LINES * ALONG):
        line, step = divmod(i, ALONG)
        back = line % 2 == 1
        x, y = ((ALONG - 1 - step if back else step) + 0.5) * LENGTH_M, line * 50.0
        rows.append((i, 100.0 * i, x, y, -60.0, np.pi if back else 0.0, LENGTH_M, 60, 4000, line))
        T = pose.matrix(np.array([x, y, -60.0]), rows[-1][5])
        grid = np.mgrid[-30:30:SPACING_M, -40:40:SPACING_M].reshape(2, -1).T + rng.uniform(0, 1, (300, 2))
        placed = pose.transform(T, np.column_stack([grid, np.zeros(len(grid))]))
        clouds.append(np.column_stack([grid, seabed(placed[:, 0], placed[:, 1]) + 60 + rng.normal(0, 0.1, len(grid))]))
    k = len(rows)
    turn = rng.uniform(0, np.pi, k)
    R = np.stack([np.cos(turn), -np.sin(turn), np.sin(turn), np.cos(turn)], -1).reshape(k, 2, 2)
    spread = np.sort(9 * rng.beta(0.5, 0.8, (k, 2)) + 0.01)
    q = R @ (spread[:, :, None] * np.swapaxes(R, 1, 2))
    return Fake(name, pd.DataFrame(rows, columns=submap.POSES.names), clouds, q)


def _report(pings: int) -> dict[str, object]:
    """Return what ingest says that it read of a survey with so many good pings of 40 soundings."""
    flagged = {"rejected": 7, "impossible": 0, "outliers": 3}
    counts = {"pings": pings + 2, "soundings": 40 * (pings + 2), "valid": 40 * pings - 10, "reordered": 0}
    skipped = {"pings that stand twice": 2, "soundings of skipped pings": 80}
    return {**counts, "flagged": flagged, "skipped": skipped, "problems": []}


def _write_survey(data: Path, fake: Fake) -> None:
    rng, poses = _rng(fake.name), fake.poses
    x = np.concatenate([np.linspace(0, 360, 180)[:: 1 - 2 * (line % 2)] for line in range(LINES)])
    y, ping = np.repeat(50.0 * np.arange(LINES), 180), np.arange(180 * LINES)
    pings = pd.DataFrame({"ping": ping, "time_s": 3.0 * ping, "x_m": x, "y_m": y, "z_m": -60.0, "file": "fake"})
    artifacts.write_table(
        data / f"surveys/{fake.name}/pings.parquet",
        pings.assign(roll_rad=0.0, pitch_rad=0.0, yaw_rad=0.0),
        survey.PINGS,
        {"crs": CRS, "origin": [0.0, 0.0], "report": _report(len(pings))},
    )
    across = np.linspace(-40, 40, 40)
    sx, sy = np.repeat(x, 40), (y[:, None] + across).ravel()
    soundings = pd.DataFrame(
        {"ping": np.repeat(ping, 40), "beam": np.tile(np.arange(40), len(ping)), "x_m": sx, "y_m": sy}
    )
    artifacts.write_table(
        data / f"surveys/{fake.name}/soundings.parquet",
        soundings.assign(z_m=seabed(sx, sy) + rng.normal(0, 0.1, len(sx)), quality=0),
        survey.SOUNDINGS,
        {},
    )
    truth = survey.TRAJECTORY.empty_table().to_pandas()
    metadata = {} if fake.name == "mine" else {"simulate": _simulation(fake.name)}
    artifacts.write_table(data / f"surveys/{fake.name}/truth.parquet", truth, survey.TRAJECTORY, metadata)
    submaps = [submap.Submap(fake.name, i, p, p[::2], p[1::2]) for i, p in enumerate(fake.clouds)]
    artifacts.write_table(_products(data, fake.name) / "submaps.parquet", submap.to_table(submaps), submap.POINTS, {})
    artifacts.write_table(_products(data, fake.name) / "poses.parquet", poses, submap.POSES, {"dropped": _DROPPED})
    unit = [voxel.normalised(points) for points in fake.clouds]
    clouds = voxel.Clouds.join(range(len(unit)), [voxel.Canonical(p.astype(np.float32), r) for p, r in unit])
    artifacts.write_arrays(_products(data, fake.name) / "clouds.npz", clouds.to_arrays(), {})


def _write_labels(data: Path, fake: Fake) -> None:
    rng, k = _rng(fake.name), len(fake.q)
    rows = pd.DataFrame(dict.fromkeys(label_table.LABELS.names, 0.0), index=range(k)).assign(
        submap=range(k), runs=50, spacing_m=2.3, self_matching=False, **_columns(fake.q), **_WENT
    )
    label = {"copy": "same", "noise_sigma_m": 0.2, "prior_variance_m2": 9.0}
    artifacts.write_table(_products(data, fake.name) / "labels.parquet", rows, label_table.LABELS, {"label": label})
    draws = np.einsum("kij,klj->kli", np.linalg.cholesky(fake.q), rng.normal(size=(k, HELD_OUT, 2)))
    samples = {"submap": np.arange(k, dtype=np.int32), "errors": draws, "held_out": draws}
    artifacts.write_arrays(_products(data, fake.name) / "errors.npz", samples, {})


def _write_variations(data: Path, fake: Fake) -> None:
    """Write labels of two submaps: Gaussian errors for the runs, and both copies by two spacings and three noises."""
    rng, rows = _rng(fake.name), []
    for number in (0, 7):
        errors = rng.multivariate_normal([0, 0], fake.q[number], 300)
        parts = [(runs, errors[i * runs : (i + 1) * runs]) for runs in (13, 30, 300) for i in range(300 // runs)]
        rows += [_variation(fake, number, "runs", "same", 0.2, 4.0, monte_carlo.covariance(e), r) for r, e in parts]
        rows += [
            _variation(fake, number, "conditions", copy, sigma, cell, (0.1 + sigma) * cell * fake.q[number], 20)
            for copy in ("same", "split")
            for sigma, cell in ((0.0, 4.0), (0.1, 4.0), (0.2, 4.0), (0.2, 8.0))
        ]
    path = _products(data, fake.name) / "variations.parquet"
    artifacts.write_table(path, pd.DataFrame(rows).assign(**_WENT), label_table.VARIATIONS, {})


def _variation(
    fake: Fake, number: int, study: str, copy: str, sigma: float, cell: float, q: np.ndarray, runs: int
) -> dict[str, object]:
    what = {"survey": fake.name, "submap": number, "study": study, "copy": copy, "noise_sigma_m": sigma}
    size = {"cell_m": cell, "spacing_m": 0.6 * cell, "points": 300, "repeat": 0, "runs": runs, "mean_y_m": 0.0}
    return {**what, **size, **{name: float(value[0]) for name, value in _columns(q[None]).items()}}


def _columns(q: np.ndarray) -> dict[str, np.ndarray]:
    return {"q_xx_m2": q[:, 0, 0], "q_xy_m2": q[:, 0, 1], "q_yy_m2": q[:, 1, 1]}


def _write_test(root: Path, fake: Fake) -> None:
    numbers, mean = range(len(fake.q)), np.broadcast_to(fake.q.mean(axis=0), fake.q.shape)
    shrunk = 0.5 * fake.q + 0.5 * mean
    q = dict(
        zip(
            METHODS,
            (fake.q, mean, np.broadcast_to(2 * np.eye(2), mean.shape), 1.3 * mean, 1.1 * fake.q, shrunk, 1.05 * fake.q),
            strict=True,
        )
    )
    for stage, methods in (("estimated", METHODS[:3]), ("predicted", METHODS[3:])):
        rows = [table.from_matrices(fake.name, method, numbers, q[method]) for method in methods]
        path = root / f"data/test/{fake.name}/{stage}.parquet"
        artifacts.write_table(path, pd.concat(rows), table.SCHEMA, {})
    own = fake.name == "mine"
    gt = np.array([pose.matrix(np.array(row[2:5], float), row[5]) for row in fake.poses.itertuples(index=False)])
    pairs = [(k, k + 2 * ALONG - 1 - 2 * (k % ALONG)) for k in range(ALONG * (LINES - 1))] if not own else []
    edges = np.array(pairs, np.int64).reshape(-1, 2)
    none, e = np.zeros(len(edges), np.int64), _rng(fake.name).normal(size=(len(edges), 2))
    graph = {"number": np.array(numbers), "gt": gt, "edge_target": edges[:, 0], "edge_source": edges[:, 1]}
    graph |= {"registration_node": edges[:, 1], "registration_error_truth_m": e}
    graph |= {"edge_draw": none, "registration_draw": none}
    artifacts.write_arrays(root / f"data/test/{fake.name}/graph.npz", graph, {})
    _write_closures(root / f"data/test/{fake.name}", fake, edges[:, 1])
    _write_slam(root / "reports/slam", fake, gt, truth=not own)
    _write_closing(root / "reports/closing", fake, gt, edges, truth=not own)
    _write_robustness(root / "reports/robustness", fake, len(edges))


def _write_closures(folder: Path, fake: Fake, sources: np.ndarray) -> None:
    """Write loop closures whose errors have twice the labels' sigma as built, and the labels' where all truly lie."""
    rng, submaps = _rng(fake.name), np.tile(sources, DRAWS)
    placed = np.einsum("kij,kj->ki", np.linalg.cholesky(fake.q[submaps]), rng.normal(size=(len(submaps), 2)))
    rows = pd.DataFrame(
        rng.random((len(submaps), len(closure_schemas.CLOSURES))), columns=closure_schemas.CLOSURES.names
    )
    errors = {"error": 2 * placed, "gt_error": 1.5 * placed, "placed_error": placed}
    columns = {f"{kind}_{axis}_m": e[:, i] for kind, e in errors.items() for i, axis in enumerate("xy")}
    index = {"draw": np.repeat(range(DRAWS), len(sources)), "submap": submaps, "targets": 1, "converged": True}
    table_ = rows.assign(survey=fake.name, **index, **columns)
    artifacts.write_table(folder / "closures.parquet", table_, closure_schemas.CLOSURES, {})
    covariances = [table.from_matrices(fake.name, "split", [], np.empty((0, 2, 2)))]
    covariances += [table.from_matrices(fake.name, m, sources, fake.q[sources]) for m in ("split", "measured_pair")]
    artifacts.write_table(folder / "closure_covariances.parquet", pd.concat(covariances), table.SCHEMA, {})
    each = table_.assign(**table.to_columns(fake.q[submaps]))
    ends = pd.concat([each.assign(method=method) for method in catalogue.OF_REGISTRATIONS])
    artifacts.write_table(folder / "closure_ends.parquet", ends[closure_schemas.ENDS.names], closure_schemas.ENDS, {})


def _write_slam(folder: Path, fake: Fake, gt: np.ndarray, truth: bool) -> None:
    rng = _rng(fake.name)
    rows, trajectories = [], [_trajectory(fake, "gt", gt[:, :3, 3])]
    if truth:
        trajectories.append(_trajectory(fake, "truth", gt[:, :3, 3] + rng.normal(0, 1, (len(gt), 3))))
    for i, method in enumerate(("navigation", "corrupted", *METHODS)):
        for variant, draw, repetition in _runs(method):
            error = (3.0, 60.0)[i] if i < 2 else rng.uniform(5, 30)
            true = dict(zip(TRUE, (1.1, 0.5, 0.2), strict=True)) if truth else {}
            measures = {"rmse_xyz_m": error, **{name: share * error for name, share in true.items()}}
            measures["map_to_map_m"] = error / 5 if draw == 0 and repetition < 2 and truth else np.nan
            measures["pose_nees"] = 0.8 if (variant, draw, repetition) == ("table", 0, 0) else np.nan
            run = {"variant": variant, "method": method, "draw": draw, "repetition": repetition}
            rows.append({"survey": fake.name, **run, **measures})
        drift = np.column_stack([np.linspace(0, error, len(gt)), np.linspace(0, -error, len(gt)), np.zeros(len(gt))])
        trajectories.append(_trajectory(fake, method, gt[:, :3, 3] + drift))
    table_ = pd.DataFrame(rows).reindex(columns=slam_schemas.ROWS.names)
    artifacts.write_table(folder / f"{fake.name}.parquet", table_, slam_schemas.ROWS, {})
    artifacts.write_table(
        folder / f"{fake.name}_trajectories.parquet", pd.concat(trajectories), slam_schemas.TRAJECTORIES, {}
    )
    _write_maps(folder, fake, [rows["which"].iloc[0] for rows in trajectories], rng)


def _write_closing(folder: Path, fake: Fake, poses: np.ndarray, edges: np.ndarray, truth: bool) -> None:
    """Write a survey that map closes better than constant, but for its last drift, of twice navigation's error."""
    rows = []
    for run, (method, error) in itertools.product(range(2), (("navigation", 2.0), ("constant", 1.5), ("map", 0.5))):
        errors = dict.fromkeys(closing_schemas.ERRORS, error if run == 0 or method != "map" else 4.0)
        counts = {"closures": len(edges), "accepted": len(edges) // 2, "flat": 0}
        key = {"survey": fake.name, "method": method, "run": run, "believed": 1.0}
        rows.append(key | (errors | {"pose_nees": 1.0, "joined_95": 0.95} if truth else {}) | counts)
    rows.append(rows[2] | {"believed": 3.0})
    table_ = pd.DataFrame(rows).reindex(columns=closing_schemas.ROWS.names)
    artifacts.write_table(folder / f"{fake.name}.parquet", table_, closing_schemas.ROWS, {})
    closed = dict(zip(("x_m", "y_m", "z_m"), poses[:, :3, 3].T, strict=True))
    sigmas = {name: 0.5 for name in closing_schemas.POSES.names if name.startswith("sigma")}
    table_ = pd.DataFrame(
        {"survey": fake.name, "submap": range(len(poses)), "time_s": 0.0, "yaw_rad": 0.0, **closed, **sigmas}
    )
    artifacts.write_table(folder / f"{fake.name}_closed.parquet", table_, closing_schemas.POSES, {})
    states = [str(list(closing_schemas.State)[k % 6]) for k in range(len(edges))]
    table_ = pd.DataFrame({"target": edges[:, 0], "source": edges[:, 1], "state": states, "survey": fake.name})
    table_ = table_.assign(share=1.0, rank=2, residual_m=0.1, moved_m=0.3, sigmas=1.0)
    artifacts.write_table(folder / f"{fake.name}_closures.parquet", table_, closing_schemas.CLOSURES, {})


def _write_robustness(folder: Path, fake: Fake, closures: int) -> None:
    """Write errors that grow with the share of false closures, by the kernel; without closures or truth, of share 0."""
    rng, rows, shares = _rng(fake.name), [], (0.0, 0.1, 0.5) if closures else (0.0,)
    for kernel, growth in (("plain", 9.0), ("cauchy", 0.1), ("gnc", 0.0)):
        for start in ("corrupted",) if kernel != "gnc" else ("corrupted", "cauchy"):
            for method, share, repetition in itertools.product(METHODS[:3], shares, (0, 1)):
                failed = kernel == "plain" and repetition == 1
                error = np.nan if failed else 5 * np.exp(growth * share) + rng.uniform(0, 1)
                condition = {"survey": fake.name, "kernel": kernel, "start": start, "method": method, "share": share}
                false = round(closures * share / (1 - share))
                counts = {"true_closures": closures, "false_closures": false, "draw": 0, "repetition": repetition}
                errors = {"rmse_xyz_m": error, "truth_rmse_xyz_m": error if closures else np.nan, "failed": failed}
                accepted = {"accepted_true": 0.9 * closures, "accepted_false": float(false if kernel == "plain" else 0)}
                rows.append({**condition, **counts, **errors, **({} if failed else accepted)})
    table_ = pd.DataFrame(rows).reindex(columns=robust_schemas.ROWS.names)
    artifacts.write_table(folder / f"{fake.name}.parquet", table_, robust_schemas.ROWS, {})
    gate = {"joined": closures, "covering": 14.0 if closures else np.nan, "both": 12.0 if closures else np.nan}
    gates = pd.DataFrame({"survey": fake.name, "at": "graph", "draw": range(DRAWS), **gate})
    artifacts.write_table(folder / f"{fake.name}_gate.parquet", gates, robust_schemas.GATE, {})


def _write_maps(folder: Path, fake: Fake, names: list[str], rng: np.random.Generator) -> None:
    column, row = (axis.ravel() for axis in np.meshgrid(np.arange(8), np.arange(-2, 3)))
    cells = {name: Cells(column, row, rng.gamma(4, 1, len(row))) for name in names}
    frame = consistency_map.Frame((650_000.0, 6_450_000.0), CRS, 15.0)
    consistency_map.write(folder / f"{fake.name}_consistency.tif", cells, frame, {})
    errors = {"cells": 40, "map_to_map_m": 4.0, "both_thinned_m": np.linspace(4, 8, 4)}
    thinned = pd.DataFrame({"survey": fake.name, "thinning": consistency_schemas.THINNINGS, **errors})
    artifacts.write_table(folder / f"{fake.name}_map_thinning.parquet", thinned, consistency_schemas.THINNING, {})


def _runs(method: str) -> list[tuple[str, int, int]]:
    """Return variant, draw and repetition of every run of a method: of the first draw the most."""
    if method == "navigation":
        return [("table", 0, 0)]
    table_ = [("table", draw, i) for draw in range(DRAWS) for i in range(REPETITIONS if draw == 0 else 2)]
    shared = [("shared", draw, i) for draw in range(DRAWS) for i in range(2)]
    return [*table_, *shared, *(("authors", draw, i) for _, draw, i in table_)] if method in protocol.FEW else table_


def _trajectory(fake: Fake, kind: str, xyz: np.ndarray) -> pd.DataFrame:
    columns = dict(zip(("x_m", "y_m", "z_m"), xyz.T, strict=True))
    return pd.DataFrame({"survey": fake.name, "which": kind, "submap": range(len(xyz)), "yaw_rad": 0.0, **columns})


def _write_training(root: Path) -> None:
    step = np.arange(1, 101)
    training = 2 * np.exp(-step / 30) + 0.4 + 0.1 * np.sin(step)
    validation = np.where(step % 10 == 0, 2 * np.exp(-step / 25) + 0.6 + 2e-5 * (step - 60) ** 2, np.nan)
    loss = pd.DataFrame({"step": step, "training": training, "validation": validation})
    for model in MODELS:
        artifacts.write_bytes(root / f"reports/train/{model}.csv", loss.to_csv(index=False).encode())
        kl = {"training": 0.45, "validation": 0.81}
        artifacts.write_json(root / f"reports/train/{model}.json", {"kl": kl, "floor_m2": 0.01})
    times = {name: {"mean_s": 10.0 ** (1 - i), "std_s": 0.1**i} for i, name in enumerate(METHODS)}
    artifacts.write_json(
        root / "reports/runtime.json", {**times, "machine": {"cpu": "a fake", "threads": 1, "params": {"runs": 50}}}
    )
    fits = {"constant_train": {"mean_kl": 1.5}, "params": {"fit": {"floor_m2": 0.02}}}
    artifacts.write_json(root / "models/fits.json", fits)
