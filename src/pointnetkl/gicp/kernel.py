"""The kernel: GICP with the motion constrained to x and y, or to x, y and yaw.

With C = I - (1 - epsilon) n n^T for both points of a match, the weight M = (C_q + R C_p R^T)^-1 needs the two normals
alone. Without yaw it does not change while the match stands, so the cost sum d^T M d is quadratic in the translation:
one 2 x 2 solve per re-matching. The sums of that solve are kept, and changed only by the points whose match changes.
"""

import math
from typing import NamedTuple

import numpy as np

from pointnetkl.gicp import matching, noise, normals
from pointnetkl.gicp.device import device, kernel

_f32, _at = np.float32, np.uint64
_TERMS = 5


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
def register(source, target, limits):  # type: ignore[no-untyped-def]
    """Register a Source onto a Target from where it is.

    Returns the motion (x, y, yaw) in metres and radians, nine sums of which the first three are M_xx, M_xy and M_yy
    in 1/m^2, iterations, whether the last step was below the tolerance, and matched points. Without any match: zeros.
    """
    n = source.points.shape[1]
    state = _state(n)
    state.points[:], state.normals[: 3 * n] = source.points, source.normals[: 3 * n]
    return _align(state, target, limits)


@kernel
def register_noisy(source, target, moves, draws, limits):  # type: ignore[no-untyped-def]
    """Register copies of a Source, each moved by (x, y) of moves (b, 2) and noise, onto a Target.

    `draws` are the first run, the two words of the key and sigma. Returns motions (b, 3) as x, y in metres and yaw in
    radians about the target's origin, iterations (b,), and whether the last step was below the tolerance (b,).
    """
    count, n = len(moves), source.points.shape[1]
    motions, iterations, converged = np.empty((count, 3)), np.empty(count, np.int32), np.empty(count, np.bool_)
    state, shaken = _state(n), np.empty((3, n), np.float32)
    state.normals[: 3 * n] = source.normals[: 3 * n]
    rows, sums = np.empty(16 * n, np.float32), np.empty_like(source.neighbourhoods)
    first, low, high, sigma = draws
    for b in range(count):
        noise.fill(shaken[0], shaken[1], shaken[2], first + b, low, high, sigma)
        if limits.recompute:
            normals.of_copy(source.points, shaken, source.neighbourhoods, source.lists, rows, sums, state.normals)
        for axis in range(3):
            _move(source.points[axis], shaken[axis], _f32(moves[b, axis]) if axis < 2 else _f32(0), state.points[axis])
        motion, _, iterations[b], converged[b], _ = _align(state, target, limits)
        motions[b, 0], motions[b, 1], motions[b, 2] = motion
    return motions, iterations, converged


@device
def _state(n):  # type: ignore[no-untyped-def]
    return _State(
        np.empty((3, n), np.float32),
        np.empty(3 * (n + normals.LANES), np.float32),
        np.empty(n, np.int32),
        np.empty(n, np.float32),
        np.empty(_TERMS * n, np.float32),
        np.empty(n, np.int32),
    )


@kernel
def _move(points, noise, by, moved):  # type: ignore[no-untyped-def]
    for i in range(len(points)):
        moved[i] = points[i] + noise[i] + by


@kernel
def _align(state, target, limits):  # type: ignore[no-untyped-def]
    # Returns the motion (x, y, yaw), the nine sums of the last solve, iterations, converged, and matched points;
    # without any match, zeros.
    state.matches[:], state.deadlines[:], state.terms[:] = -1, -1, 0
    sums = np.zeros(9)  # M_xx, M_xy, M_yy, (M d)_x, (M d)_y; and with yaw: M_x,yaw, M_y,yaw, M_yaw,yaw, (J^T M d)_yaw
    x, y, yaw, way, turned = 0.0, 0.0, 0.0, 0.0, 0.0
    lever = _lever(state.points[0], state.points[1])
    iterations, matched, converged = 0, 0, False
    while iterations < limits.iterations and not converged:
        if not limits.keep:
            state.deadlines[:] = -1
        matched += _rematch(state, target, limits, sums, x, y, yaw, way, turned)
        if matched == 0:
            return (0.0, 0.0, 0.0), np.zeros(9), iterations, False, 0
        if limits.yaw:
            _sum_with_yaw(state, target, limits.epsilon, sums, x, y, yaw)
            step_x, step_y, turn = _solve_with_yaw(sums)
        else:
            to_x, to_y = _solve(sums)
            step_x, step_y, turn = to_x - x, to_y - y, 0.0
        step = math.hypot(step_x, step_y)
        x, y, yaw, way, turned = x + step_x, y + step_y, yaw + turn, way + step, turned + abs(turn)
        iterations += 1
        converged = step < limits.tolerance and abs(turn) * lever < limits.tolerance
    return (x, y, yaw), sums, iterations, converged, matched


@device
def _lever(x, y):  # type: ignore[no-untyped-def]
    # how far a typical point moves when the cloud turns by a radian, metres
    total = 0.0
    for i in range(len(x)):
        total += x[i] * x[i] + y[i] * y[i]
    return math.sqrt(total / len(x))


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
        n, t = _at(3) * i, _at(_TERMS) * i
        matched = _f32(matches[i] >= 0)
        xx, xy, yy, gx, gy = weigh(
            px[i], py[i], pz[i], normals[n], normals[n + _at(1)], normals[n + _at(2)],
            points, target_normals, _at(3) * _at(max(matches[i], 0)), epsilon,
        )  # fmt: skip
        xx, xy, yy, gx, gy = matched * xx, matched * xy, matched * yy, matched * gx, matched * gy
        s0 += xx - terms[t]
        s1 += xy - terms[t + _at(1)]
        s2 += yy - terms[t + _at(2)]
        s3 += gx - terms[t + _at(3)]
        s4 += gy - terms[t + _at(4)]
        terms[t], terms[t + _at(1)], terms[t + _at(2)], terms[t + _at(3)], terms[t + _at(4)] = xx, xy, yy, gx, gy
    sums[0], sums[1], sums[2], sums[3], sums[4] = s0, s1, s2, s3, s4


@device
def weigh(px, py, pz, ax, ay, az, points, normals, j, epsilon):  # type: ignore[no-untyped-def]
    """Return M_xx, M_xy, M_yy, (M d)_x, (M d)_y of a point, its normal and its match at j, 3 times its number.

    d is from the point to its match, of points (3 n,) and normals (3 n,).
    M = (2 I - w (a a^T + b b^T))^-1 with w = 1 - epsilon, by Woodbury: I / 2 + [a b] S [a b]^T with
    S = [[same, cross], [cross, same]].
    """
    half = _f32(0.5)
    bx, by, bz = normals[j], normals[j + _at(1)], normals[j + _at(2)]
    dx, dy, dz = points[j] - px, points[j + _at(1)] - py, points[j + _at(2)] - pz
    w, m = _f32(1) - epsilon, _f32(1) + epsilon
    c = w * (ax * bx + ay * by + az * bz)
    scale = half * w / (m * m - c * c)
    same, cross = m * scale, c * scale
    along_a, along_b = ax * dx + ay * dy + az * dz, bx * dx + by * dy + bz * dz
    u, v = same * along_a + cross * along_b, cross * along_a + same * along_b
    xx = half + same * (ax * ax + bx * bx) + (cross + cross) * ax * bx
    xy = same * (ax * ay + bx * by) + cross * (ax * by + ay * bx)
    yy = half + same * (ay * ay + by * by) + (cross + cross) * ay * by
    return _f32(xx), _f32(xy), _f32(yy), half * dx + ax * u + bx * v, half * dy + ay * u + by * v


@device
def _solve(sums):  # type: ignore[no-untyped-def]
    # M is at least I / 2 for every match, so with any match at all the determinant is positive
    xx, xy, yy, gx, gy = sums[0], sums[1], sums[2], sums[3], sums[4]
    determinant = xx * yy - xy * xy
    return (yy * gx - xy * gy) / determinant, (xx * gy - xy * gx) / determinant


@kernel
def _sum_with_yaw(state, target, epsilon, sums, x, y, yaw):  # type: ignore[no-untyped-def]
    # The source's normals turn with it, so M changes at every step: all the sums are made anew, of the moved source.
    px, py, pz, n = state.points[0], state.points[1], state.points[2], state.normals
    cosine, sine, tx, ty = _f32(math.cos(yaw)), _f32(math.sin(yaw)), _f32(x), _f32(y)
    sums[:] = 0
    for i in range(len(px)):
        if state.matches[i] >= 0:
            rx, ry = cosine * px[i] - sine * py[i], sine * px[i] + cosine * py[i]
            ax, ay = cosine * n[3 * i] - sine * n[3 * i + 1], sine * n[3 * i] + cosine * n[3 * i + 1]
            xx, xy, yy, gx, gy = weigh(
                rx + tx, ry + ty, pz[i], ax, ay, n[3 * i + 2],
                target.points, target.normals, _at(3) * _at(state.matches[i]), epsilon,
            )  # fmt: skip
            # the column of yaw in the Jacobian is (-ry, rx)
            x_yaw, y_yaw = xy * rx - xx * ry, yy * rx - xy * ry
            for term, value in enumerate(
                (xx, xy, yy, gx, gy, x_yaw, y_yaw, y_yaw * rx - x_yaw * ry, gy * rx - gx * ry)
            ):
                sums[term] += value


@device
def _solve_with_yaw(sums):  # type: ignore[no-untyped-def]
    # by Schur: yaw first, then x and y given yaw; a cloud of one place cannot turn
    xx, xy, yy, gx, gy, x_yaw, y_yaw, yaw_yaw, g_yaw = sums
    determinant = xx * yy - xy * xy
    ux, uy = (yy * x_yaw - xy * y_yaw) / determinant, (xx * y_yaw - xy * x_yaw) / determinant
    left = yaw_yaw - ux * x_yaw - uy * y_yaw
    turn = (g_yaw - ux * gx - uy * gy) / left if left > 1e-12 * yaw_yaw else 0.0
    fx, fy = gx - turn * x_yaw, gy - turn * y_yaw
    return (yy * fx - xy * fy) / determinant, (xx * fy - xy * fx) / determinant, turn
