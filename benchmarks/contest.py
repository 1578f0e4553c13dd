"""Engines that register the same noisy copies of one submap in turns, each timed."""

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

import peers
import submaps
from pointnetkl.registration import gicp, monte_carlo
from pointnetkl.registration.covariance import gaussian
from pointnetkl.registration.gicp import normals

OPEN3D_RUNS = 5  # a repetition: it is only quoted

Row = dict[str, Any]


class Contest:
    """A submap, the engines prepared to register copies of it, and the errors they have made."""

    def __init__(
        self, ground: submaps.Ground, label: monte_carlo.Settings, registration: gicp.Settings, open3d: bool = False
    ):
        """Prepare the submap, and register two copies that do not count, so that all is compiled and loaded.

        Raises:
            GicpError: the submap cannot be registered.
            BenchmarkError: a library is missing.
        """
        self._label, self._registration = label, registration
        self._cloud = gicp.prepare(ground.points, registration)
        # both engines get the points sorted by place, as ours are: caches like it
        self._points = self._cloud.points - self._cloud.points.mean(axis=0)
        self._small = peers.SmallGicp(self._points, registration)
        self._other = peers.Open3d(self._points, registration) if open3d else None
        self._errors: dict[str, list[np.ndarray]] = {"ours": [], "ours_yaw": [], "small_gicp": []}
        self.repeat(runs=2, seed=[0])
        for errors in self._errors.values():
            errors.clear()

    def repeat(self, runs: int, seed: list[int]) -> Row:
        """Register so many new copies with every engine; return milliseconds and iterations of one registration."""
        rng = np.random.default_rng(seed)
        noise = gicp.Noise(self._label.noise_sigma_m, key=int(rng.integers(1 << 63)))
        moves = rng.standard_normal((runs, 2)) * np.sqrt(self._label.prior_variance_m2)
        engines: list[Callable[[np.ndarray, gicp.Noise], Row]] = [self._ours, self._small_gicp, self._open3d]
        row: Row = {}
        # who comes first changes, because a processor slows down as it gets warm
        for engine in engines if seed[-1] % 2 else engines[::-1]:
            row |= engine(moves, noise)
        return row

    def kl(self, ours: str, floor_m2: float) -> float:
        """Return KL(ours || small_gicp) of the covariances of the errors so far, nats; ours: `ours` or `ours_yaw`."""
        p, q = (
            gaussian.with_floor(monte_carlo.covariance(np.concatenate(self._errors[name])), floor_m2)
            for name in (ours, "small_gicp")
        )
        return float(gaussian.kl_divergence(p, q))

    def _ours(self, moves: np.ndarray, noise: gicp.Noise) -> Row:
        arguments = self._cloud, self._cloud, moves, noise, self._registration
        preparing, full, timed_normals, with_yaw, drawing = (_Clock() for _ in range(5))
        with preparing:
            cloud = gicp.prepare(self._points, self._registration)
            gicp.register_noisy(
                cloud, cloud, moves[:0], noise, self._registration
            )  # makes what the first run waits for
        with full:
            found = gicp.register_noisy(*arguments)
        with drawing:
            drawn = noise.draw(len(moves), len(self._points))
        with timed_normals:
            self._normals(drawn)
        with with_yaw:
            turned = gicp.register_noisy(*arguments[:-1], replace(self._registration, dof="xyyaw"))
        self._errors["ours"].append(moves + found.T_target_copy.translation)
        self._errors["ours_yaw"].append(moves + turned.T_target_copy.translation)
        return {
            "ours_ms": full.ms / len(moves),
            "ours_prepared_ms": (full.ms - timed_normals.ms) / len(moves),
            "ours_yaw_ms": with_yaw.ms / len(moves),
            "noise_ms": drawing.ms / len(moves),
            "ours_prepare_once_ms": preparing.ms,
            "ours_iterations": float(found.iterations.mean()),
            "ours_converged_share": float(found.converged.mean()),
            "ours_cores": full.cores,
        }

    def _normals(self, drawn: np.ndarray) -> None:
        """Compute the normals of the copies that noise (runs, n, 3) makes, as `register_noisy` does."""
        clean, n = self._cloud.as_source(self._cloud, np.zeros(3)), len(self._cloud.points)
        rows, sums = np.empty(normals.ROW * n, np.float32), np.empty_like(clean.neighbourhoods)
        upwards = np.empty(3 * (n + normals.LANES), np.float32)
        for shifts in np.swapaxes(drawn, 1, 2):
            normals.fill_normals(clean.points, shifts, clean.neighbourhoods, clean.lists, rows, sums, upwards)

    def _small_gicp(self, moves: np.ndarray, noise: gicp.Noise) -> Row:
        copies = self._copies(moves, noise)
        with _Clock() as clock:
            found = [self._small.register(copy) for copy in copies]
        self._errors["small_gicp"].append(moves + np.stack([each.translation for each in found]))
        seconds, preparing = np.transpose([[each.seconds, each.preparing_s] for each in found])
        return {
            "small_gicp_ms": 1e3 * float(seconds.mean()),
            "small_gicp_prepared_ms": 1e3 * float((seconds - preparing).mean()),
            "small_gicp_prepare_once_ms": 1e3 * self._small.prepare_s,
            "small_gicp_iterations": float(np.mean([each.iterations for each in found])),
            "small_gicp_converged_share": float(np.mean([each.converged for each in found])),
            "small_gicp_cores": clock.cores,
        }

    def _open3d(self, moves: np.ndarray, noise: gicp.Noise) -> Row:
        if self._other is None:
            return {}
        copies = self._copies(moves[:OPEN3D_RUNS], noise)
        with _Clock() as clock:
            found = [self._other.register(copy) for copy in copies]
        return {"open3d_ms": 1e3 * float(np.mean([each.seconds for each in found])), "open3d_cores": clock.cores}

    def _copies(self, moves: np.ndarray, noise: gicp.Noise) -> np.ndarray:
        drawn = noise.draw(len(moves), len(self._points))
        # in one piece, or each library would copy its own into one while it is timed
        return np.ascontiguousarray(self._points + np.pad(moves, ((0, 0), (0, 1)))[:, None] + drawn)


class _Clock:
    """Wall-clock milliseconds, and how many cores were busy meanwhile."""

    def __enter__(self) -> "_Clock":
        self._begun = time.perf_counter(), time.process_time()
        return self

    def __exit__(self, *_: object) -> None:
        wall, used = time.perf_counter() - self._begun[0], time.process_time() - self._begun[1]
        self.ms, self.cores = 1e3 * wall, used / wall
