"""The kernel: GICP with the motion constrained to x and y, or to x, y and yaw.

`registration.reference` has the same method in plain NumPy: read it first.

With C = I - (1 - epsilon) n n^T for both points of a match, the weight W = (C_q + R C_p R^T)^-1 needs the two normals
alone. Without yaw it does not change while the match stands, so the cost sum d^T W d is quadratic in the translation:
one 2 x 2 solve per re-matching. The sums of that solve are kept, and changed only by the points whose match changes.
"""

import math
from typing import NamedTuple

import numpy as np

from pointnetkl.registration.gicp import matching, noise, normals, weights, yaw_step
from pointnetkl.registration.gicp.device import device, kernel

_f32, _u64 = np.float32, np.uint64


class Source(NamedTuple):
    """A cloud to be moved, in the target's axes, metres."""

    points: np.ndarray  # (3, n) float32
    normals: np.ndarray  # (3 n,) float32, unit
    neighbourhoods: np.ndarray  # of normals.neighbourhoods, flat: what noisy copies' normals start from
    lists: np.ndarray  # (n, k) uint32


class Limits(NamedTuple):
    """The settings of a registration."""

    epsilon: np.float32  # variance along a normal, against 1 in the plane
    max_distance: np.float32  # metres, of a match
    tolerance: float  # metres
    max_iterations: int
    with_yaw: bool


class Copy(NamedTuple):
    """A copy of the source before it is moved, and what is kept of it from one iteration to the next."""

    x: np.ndarray  # (n,) float32 metres, in the target's axes
    y: np.ndarray
    z: np.ndarray
    normals: np.ndarray  # (3 n,) float32
    matches: np.ndarray  # (n,) int32, the target's points; -1: none
    deadlines: np.ndarray  # (n,) float32, metres of motion at which the match is to be searched again
    terms: np.ndarray  # (5 n,) float32, a point's part of the sums
    stale: np.ndarray  # (n,) int32, the points to be searched now


class Motion(NamedTuple):
    """Where a copy has been moved to, and how far it has gone to get there."""

    x: float  # metres
    y: float
    yaw: float  # radians, about the target's origin
    travel: float  # metres, the sum of the lengths of its steps
    rotation: float  # radians, the sum of their turns' sizes


@kernel
def register(source, target, start_yaw, limits):  # type: ignore[no-untyped-def]
    """Register a Source onto a Target from where it is, turned by a yaw in radians about the target's origin.

    Returns the motion (x, y, yaw) in metres and radians, nine sums of which the first three are M_xx, M_xy and M_yy
    in 1/m^2, iterations, whether the last step was below the tolerance, and matched points. Without any match: the turn
    alone, and zeros.
    """
    n = source.points.shape[1]
    copy = allocate(n)
    copy.x[:], copy.y[:], copy.z[:] = source.points[0], source.points[1], source.points[2]
    copy.normals[: 3 * n] = source.normals[: 3 * n]
    return align(copy, target, start_yaw, limits)


@kernel
def register_noisy(source, target, moves, start_yaws, draws, limits):  # type: ignore[no-untyped-def]
    """Register copies of a Source, each moved by (x, y) of moves (b, 2) and noise, onto a Target.

    A search begins with the copy turned by its start_yaw (b,), radians, zero without yaw. `draws` are the first run,
    the two words of the key and sigma. Returns motions (b, 3) as x, y in metres and yaw in radians about the target's
    origin, iterations (b,), and whether the last step was below the tolerance (b,).
    """
    count, n = len(moves), source.points.shape[1]
    motions, iterations, converged = np.empty((count, 3)), np.empty(count, np.int32), np.empty(count, np.bool_)
    copy, shifts = allocate(n), np.empty((3, n), np.float32)
    rows, sums = np.empty(normals.ROW * n, np.float32), np.empty_like(source.neighbourhoods)
    first, low, high, sigma = draws
    for b in range(count):
        noise.fill(shifts[0], shifts[1], shifts[2], first + b, low, high, sigma)
        normals.fill_normals(source.points, shifts, source.neighbourhoods, source.lists, rows, sums, copy.normals)
        _move(source.points[0], shifts[0], _f32(moves[b, 0]), copy.x)
        _move(source.points[1], shifts[1], _f32(moves[b, 1]), copy.y)
        _move(source.points[2], shifts[2], _f32(0), copy.z)
        motion, _, iterations[b], converged[b], _ = align(copy, target, start_yaws[b], limits)
        motions[b, 0], motions[b, 1], motions[b, 2] = motion
    return motions, iterations, converged


@device
def allocate(n):  # type: ignore[no-untyped-def]
    """Return room for a Copy of n points."""
    return Copy(
        np.empty(n, np.float32),
        np.empty(n, np.float32),
        np.empty(n, np.float32),
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
def align(copy, target, start_yaw, limits):  # type: ignore[no-untyped-def]
    """Align a Copy, of which x, y, z and normals are filled, with a Target; return what `register` does."""
    copy.matches[:], copy.deadlines[:], copy.terms[:] = -1, -1, 0
    sums = np.zeros(9)  # M_xx, M_xy, M_yy, (M d)_x, (M d)_y; and with yaw: M_x,yaw, M_y,yaw, M_yaw,yaw, (J^T M d)_yaw
    motion = Motion(0.0, 0.0, start_yaw, 0.0, 0.0)
    lever = yaw_step.lever(copy.x, copy.y)
    iterations, matched, converged = 0, 0, False
    while iterations < limits.max_iterations and not converged:
        matched += _rematch(copy, target, motion, limits, sums)
        if matched == 0:
            return (0.0, 0.0, motion.yaw), np.zeros(9), iterations, False, 0
        if limits.with_yaw:
            yaw_step.fill_sums(copy, target, motion, limits.epsilon, sums)
            step_x, step_y, turn = yaw_step.solve(sums)
        else:
            x, y = weights.solve(sums)
            step_x, step_y, turn = x - motion.x, y - motion.y, 0.0
        step = math.hypot(step_x, step_y)
        motion = Motion(
            motion.x + step_x, motion.y + step_y, motion.yaw + turn, motion.travel + step, motion.rotation + abs(turn)
        )
        iterations += 1
        converged = step < limits.tolerance and abs(turn) * lever < limits.tolerance
    return (motion.x, motion.y, motion.yaw), sums, iterations, converged, matched


@kernel
def _rematch(copy, target, motion, limits, sums):  # type: ignore[no-untyped-def]
    # searches the matches that the motion so far may have changed; returns how many more points are matched
    stale = _find_stale(copy, _f32(motion.travel), _f32(motion.rotation))
    changed, growth = _match(copy, target, motion, limits.max_distance, stale)
    if not limits.with_yaw:
        _exchange(copy, target, limits.epsilon, changed, sums)
    return growth


@device
def _find_stale(copy, travel, rotation):  # type: ignore[no-untyped-def]
    # a point goes no farther than the cloud, and its distance from the origin times what the cloud has turned
    px, py, deadlines, stale = copy.x, copy.y, copy.deadlines, copy.stale
    count = 0
    if rotation == 0:
        for i in range(len(px)):
            stale[_u64(count)] = i
            count += not travel < deadlines[i]
    else:
        for i in range(len(px)):
            stale[_u64(count)] = i
            count += not travel + rotation * (abs(px[i]) + abs(py[i])) < deadlines[i]
    return count


@kernel
def _match(copy, target, motion, max_distance, count):  # type: ignore[no-untyped-def]
    # Matches the first `count` stale points; leaves in `stale` those whose match is another one; returns how many
    # these are, and how many more points are matched. A match stands while the motion since it was found is under half
    # the gap to the second nearest; the margin keeps that true of rounded numbers.
    px, py, pz, matches, deadlines, stale = copy.x, copy.y, copy.z, copy.matches, copy.deadlines, copy.stale
    cosine, sine, tx, ty = _f32(math.cos(motion.yaw)), _f32(math.sin(motion.yaw)), _f32(motion.x), _f32(motion.y)
    travel, rotation = _f32(motion.travel), _f32(motion.rotation)
    changed, growth, near, other = 0, 0, np.int32(-1), np.int32(-1)
    for s in range(count):
        i = _u64(stale[_u64(s)])
        qx, qy = cosine * px[i] - sine * py[i] + tx, sine * px[i] + cosine * py[i] + ty
        hint, other_hint = near, other
        near, other, near_m, other_m, exact = matching.look_up(qx, qy, pz[i], target)
        if not exact or other_m >= max_distance:
            within = min(max_distance, other_m * _f32(1.00001) + target.margin)
            near, other, near_m, other_m = matching.search(qx, qy, pz[i], within, hint, other_hint, target)
        slack = _f32(0.5) * (other_m - near_m) - target.margin
        deadlines[i] = slack + travel + rotation * (abs(px[i]) + abs(py[i]))
        old = matches[i]
        matches[i] = near
        growth += (near >= 0) - (old >= 0)
        stale[_u64(changed)] = i
        changed += near != old
    return changed, growth


@kernel
def _exchange(copy, target, epsilon, count, sums):  # type: ignore[no-untyped-def]
    # Puts the new terms of the first `count` stale points into the sums, in place of their old ones. d is that of the
    # unmoved copy: the solve then answers with the whole translation.
    px, py, pz, terms = copy.x, copy.y, copy.z, copy.terms
    s0, s1, s2, s3, s4 = sums[0], sums[1], sums[2], sums[3], sums[4]
    for c in range(count):
        i = _u64(copy.stale[_u64(c)])
        n, t = _u64(3) * i, _u64(weights.TERMS) * i
        matched = _f32(copy.matches[i] >= 0)
        xx, xy, yy, gx, gy = weights.weigh(
            px[i], py[i], pz[i], copy.normals[n], copy.normals[n + _u64(1)], copy.normals[n + _u64(2)],
            target.points, target.normals, _u64(3) * _u64(max(copy.matches[i], 0)), epsilon,
        )  # fmt: skip
        xx, xy, yy, gx, gy = matched * xx, matched * xy, matched * yy, matched * gx, matched * gy
        s0 += np.float64(xx) - np.float64(terms[t])
        s1 += np.float64(xy) - np.float64(terms[t + _u64(1)])
        s2 += np.float64(yy) - np.float64(terms[t + _u64(2)])
        s3 += np.float64(gx) - np.float64(terms[t + _u64(3)])
        s4 += np.float64(gy) - np.float64(terms[t + _u64(4)])
        terms[t], terms[t + _u64(1)], terms[t + _u64(2)], terms[t + _u64(3)], terms[t + _u64(4)] = xx, xy, yy, gx, gy
    sums[0], sums[1], sums[2], sums[3], sums[4] = s0, s1, s2, s3, s4
