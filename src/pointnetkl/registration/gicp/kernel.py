"""The kernel: GICP with the motion constrained to x and y, or to x, y and yaw.

With C = I - (1 - epsilon) n n^T for both points of a match, the weight M = (C_q + R C_p R^T)^-1 needs the two normals
alone. Without yaw it does not change while the match stands, so the cost sum d^T M d is quadratic in the translation:
one 2 x 2 solve per re-matching. The sums of that solve are kept, and changed only by the points whose match changes.
"""

import math
from typing import NamedTuple

import numpy as np

from pointnetkl.registration.gicp import matching, noise, normals, turning, weights
from pointnetkl.registration.gicp.device import device, kernel

_f32, _at = np.float32, np.uint64


class Source(NamedTuple):
    """A cloud to be moved, in the target's axes, metres."""

    points: np.ndarray  # (3, n) float32
    normals: np.ndarray  # (3 n,) float32, unit
    neighbourhoods: np.ndarray  # of normals.neighbourhoods, flat: what noisy copies' normals start from
    lists: np.ndarray  # (n, k) uint32


class Limits(NamedTuple):
    """The settings of a registration; the last two are there to be compared with, and are true."""

    epsilon: np.float32
    farthest: np.float32  # metres, of a match
    tolerance: float  # metres
    iterations: int
    yaw: bool
    recompute: bool  # a copy's normals, from its noisy points; else it has those of the clean cloud
    keep: bool  # matches while they cannot change; else every one is searched anew at every iteration


class _State(NamedTuple):
    points: np.ndarray  # (3, n) float32, of the copy before it is moved
    normals: np.ndarray  # (3 n,) float32
    matches: np.ndarray  # (n,) int32, -1: none
    deadlines: np.ndarray  # (n,) float32, metres of motion at which the match is to be searched again
    terms: np.ndarray  # (5 n,) float32, a point's part of the sums
    stale: np.ndarray  # (n,) int32, the points to be searched now


@kernel
def register(source, target, turn, limits):  # type: ignore[no-untyped-def]
    """Register a Source onto a Target from where it is, turned by so many radians about the target's origin.

    Returns the motion (x, y, yaw) in metres and radians, nine sums of which the first three are M_xx, M_xy and M_yy
    in 1/m^2, iterations, whether the last step was below the tolerance, and matched points. Without any match: the turn
    alone, and zeros.
    """
    n = source.points.shape[1]
    state = _state(n)
    state.points[:], state.normals[: 3 * n] = source.points, source.normals[: 3 * n]
    return _align(state, target, turn, limits)


@kernel
def register_noisy(source, target, moves, turns, draws, limits):  # type: ignore[no-untyped-def]
    """Register copies of a Source, each moved by (x, y) of moves (b, 2) and noise, onto a Target.

    A search begins with the copy turned by turns (b,), radians, zero without yaw. `draws` are the first run, the two
    words of the key and sigma. Returns motions (b, 3) as x, y in metres and yaw in radians about the target's origin,
    iterations (b,), and whether the last step was below the tolerance (b,).
    """
    count, n = len(moves), source.points.shape[1]
    motions, iterations, converged = np.empty((count, 3)), np.empty(count, np.int32), np.empty(count, np.bool_)
    state, shaken = _state(n), np.empty((3, n), np.float32)
    state.normals[: 3 * n] = source.normals[: 3 * n]
    rows, sums = np.empty(normals.ROW * n, np.float32), np.empty_like(source.neighbourhoods)
    first, low, high, sigma = draws
    for b in range(count):
        noise.fill(shaken[0], shaken[1], shaken[2], first + b, low, high, sigma)
        if limits.recompute:
            normals.of_copy(source.points, shaken, source.neighbourhoods, source.lists, rows, sums, state.normals)
        for axis in range(3):
            _move(source.points[axis], shaken[axis], _f32(moves[b, axis]) if axis < 2 else _f32(0), state.points[axis])
        motion, _, iterations[b], converged[b], _ = _align(state, target, turns[b], limits)
        motions[b, 0], motions[b, 1], motions[b, 2] = motion
    return motions, iterations, converged


@device
def _state(n):  # type: ignore[no-untyped-def]
    return _State(
        np.empty((3, n), np.float32),
        np.empty(3 * (n + normals.LANES), np.float32),
        np.empty(n, np.int32),
        np.empty(n, np.float32),
        np.empty(weights.TERMS * n, np.float32),
        np.empty(n, np.int32),
    )


@kernel
def _move(points, noise, by, moved):  # type: ignore[no-untyped-def]
    for i in range(len(points)):
        moved[i] = points[i] + noise[i] + by


@kernel
def _align(state, target, turn, limits):  # type: ignore[no-untyped-def]
    # Returns the motion (x, y, yaw), the nine sums of the last solve, iterations, converged, and matched points;
    # without any match, the turn that it began with, and zeros.
    state.matches[:], state.deadlines[:], state.terms[:] = -1, -1, 0
    sums = np.zeros(9)  # M_xx, M_xy, M_yy, (M d)_x, (M d)_y; and with yaw: M_x,yaw, M_y,yaw, M_yaw,yaw, (J^T M d)_yaw
    x, y, yaw, way, turned = 0.0, 0.0, turn, 0.0, 0.0
    lever = turning.lever(state.points[0], state.points[1])
    iterations, matched, converged = 0, 0, False
    while iterations < limits.iterations and not converged:
        if not limits.keep:
            state.deadlines[:] = -1
        matched += _rematch(state, target, limits, sums, x, y, yaw, way, turned)
        if matched == 0:
            return (0.0, 0.0, yaw), np.zeros(9), iterations, False, 0
        if limits.yaw:
            turning.fill_sums(state, target, limits.epsilon, sums, x, y, yaw)
            step_x, step_y, turn = turning.solve(sums)
        else:
            to_x, to_y = weights.solve(sums)
            step_x, step_y, turn = to_x - x, to_y - y, 0.0
        step = math.hypot(step_x, step_y)
        x, y, yaw, way, turned = x + step_x, y + step_y, yaw + turn, way + step, turned + abs(turn)
        iterations += 1
        converged = step < limits.tolerance and abs(turn) * lever < limits.tolerance
    return (x, y, yaw), sums, iterations, converged, matched


@kernel
def _rematch(state, target, limits, sums, x, y, yaw, way, turned):  # type: ignore[no-untyped-def]
    # Searches the matches that the motion so far, a way of so many metres and radians, may have changed; returns how
    # many more points are matched.
    px, py, pz = state.points[0], state.points[1], state.points[2]
    turned, way = _f32(turned), _f32(way)
    stale = _find_stale(px, py, state.deadlines, way, turned, state.stale)
    pose = (_f32(math.cos(yaw)), _f32(math.sin(yaw)), _f32(x), _f32(y))
    changed, growth = _match(
        px, py, pz, pose, way, turned, state.stale[:stale], state.matches, state.deadlines, target, limits.farthest
    )
    if not limits.yaw:
        _exchange(
            px, py, pz, state.normals, state.matches, state.stale[:changed], target.points, target.normals,
            limits.epsilon, state.terms, sums,
        )  # fmt: skip
    return growth


@device
def _find_stale(px, py, deadlines, way, turned, stale):  # type: ignore[no-untyped-def]
    # a point's way is no longer than the cloud's, and its distance from the origin times what the cloud has turned
    count = 0
    if turned == 0:
        for i in range(len(px)):
            stale[_at(count)] = i
            count += not way < deadlines[i]
    else:
        for i in range(len(px)):
            stale[_at(count)] = i
            count += not way + turned * (abs(px[i]) + abs(py[i])) < deadlines[i]
    return count


@kernel
def _match(px, py, pz, pose, way, turned, stale, matches, deadlines, target, farthest):  # type: ignore[no-untyped-def]
    # Matches the stale points; leaves in `stale` those whose match is another one; returns how many these are, and how
    # many more points are matched. A match stands while the motion since it was found is under half the gap to the
    # second nearest; the margin keeps that true of rounded numbers.
    cosine, sine, tx, ty = pose
    changed, growth, near, other = 0, 0, np.int32(-1), np.int32(-1)
    for s in range(len(stale)):
        i = _at(stale[_at(s)])
        qx, qy = cosine * px[i] - sine * py[i] + tx, sine * px[i] + cosine * py[i] + ty
        hint, other_hint = near, other
        near, other, near_m, other_m, exact = matching.look_up(qx, qy, pz[i], target)
        if not exact or other_m >= farthest:
            within = min(farthest, other_m * _f32(1.00001) + target.margin)
            near, other, near_m, other_m = matching.search(qx, qy, pz[i], within, hint, other_hint, target)
        slack = _f32(0.5) * (other_m - near_m) - target.margin
        deadlines[i] = slack + way + turned * (abs(px[i]) + abs(py[i]))
        old = matches[i]
        matches[i] = near
        growth += (near >= 0) - (old >= 0)
        stale[_at(changed)] = i
        changed += near != old
    return changed, growth


@kernel
def _exchange(px, py, pz, normals, matches, changed, points, target_normals, epsilon, terms, sums):  # type: ignore[no-untyped-def]
    # d of the unmoved source: the solve then answers with the whole translation
    s0, s1, s2, s3, s4 = sums[0], sums[1], sums[2], sums[3], sums[4]
    for c in range(len(changed)):
        i = _at(changed[_at(c)])
        n, t = _at(3) * i, _at(weights.TERMS) * i
        matched = _f32(matches[i] >= 0)
        xx, xy, yy, gx, gy = weights.weigh(
            px[i], py[i], pz[i], normals[n], normals[n + _at(1)], normals[n + _at(2)],
            points, target_normals, _at(3) * _at(max(matches[i], 0)), epsilon,
        )  # fmt: skip
        xx, xy, yy, gx, gy = matched * xx, matched * xy, matched * yy, matched * gx, matched * gy
        s0 += np.float64(xx) - np.float64(terms[t])
        s1 += np.float64(xy) - np.float64(terms[t + _at(1)])
        s2 += np.float64(yy) - np.float64(terms[t + _at(2)])
        s3 += np.float64(gx) - np.float64(terms[t + _at(3)])
        s4 += np.float64(gy) - np.float64(terms[t + _at(4)])
        terms[t], terms[t + _at(1)], terms[t + _at(2)], terms[t + _at(3)], terms[t + _at(4)] = xx, xy, yy, gx, gy
    sums[0], sums[1], sums[2], sums[3], sums[4] = s0, s1, s2, s3, s4
