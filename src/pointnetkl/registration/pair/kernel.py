"""The kernel: MAP registration, Gauss-Newton along normals with the prior of the start as a factor.

`pair.reference` has the same method in plain NumPy: read it first. Matches are searched, kept and exchanged as in
`gicp.kernel`, whose own steps are called here: they are private there, and stay so, because shards of labels are named
by a hash of that file's statements. Ten sums decide a step. Without yaw they change only by the points whose match
changes, and d is that of the unmoved copy; with yaw they are added up anew at every place.
"""

import math
from typing import NamedTuple

import numpy as np

from pointnetkl.registration.gicp import kernel as gicp
from pointnetkl.registration.gicp import yaw_step
from pointnetkl.registration.pair import along_normals
from pointnetkl.registration.pair.compilation import device, kernel

_f32, _u64 = np.float32, np.uint64
_SUMS = 10  # H_xx, H_xy, H_yy, f_x, f_y, H_x,yaw, H_y,yaw, H_yaw,yaw, f_yaw, and d^T M_n d
_TERMS = 6  # of a point, without yaw: the first five, and the last
_LEAST_VARIANCE_M2 = 1e-12  # of residuals: a copy of the very points has none


class Search(NamedTuple):
    """How the most probable place is searched, beside gicp.kernel.Limits."""

    precision: np.ndarray  # (3, 3) 1/m^2, 1/rad^2 of the start of x, y and yaw; without yaw any in its place
    residuals_as_one: float
    longest_step: float  # metres
    tolerance_sigmas: float  # of a step, in sigmas of the place
    least_matches: int


class Cloud(NamedTuple):
    """A source as it is searched, and where its centroid is before it is turned and moved."""

    copy: gicp.Copy
    x: float  # metres, in the target's axes
    y: float
    lever: float  # metres, see reference.lever_m


class Source(NamedTuple):
    """A cloud to be moved; the kernel takes it to the target's axes."""

    points: np.ndarray  # (n, 3) float64 metres
    normals: np.ndarray  # (n, 3) float32, unit
    centre: np.ndarray  # (3,) float64 metres: the target's, where its axes begin
    move: np.ndarray  # (2,) float64 metres, added before it is turned


@kernel
def load(source):  # type: ignore[no-untyped-def]
    """Return a Source as a Cloud without matches."""
    n = len(source.points)
    copy = gicp.allocate(n)
    for i in range(n):
        copy.x[i] = source.points[i, 0] - source.centre[0] + source.move[0]
        copy.y[i] = source.points[i, 1] - source.centre[1] + source.move[1]
        copy.z[i] = source.points[i, 2] - source.centre[2]
    copy.normals[: 3 * n] = source.normals.reshape(-1)
    copy.matches[:], copy.deadlines[:] = -1, -1
    x, y, squares = 0.0, 0.0, 0.0
    for i in range(n):
        x += copy.x[i]
        y += copy.y[i]
    x, y = x / n, y / n
    for i in range(n):
        squares += (copy.x[i] - x) ** 2 + (copy.y[i] - y) ** 2
    return Cloud(copy, x, y, max(math.sqrt(squares / n), 1e-6))


@kernel
def find(cloud, target, start_yaw, limits, search):  # type: ignore[no-untyped-def]
    """Search the most probable place of a Cloud that starts turned by a yaw in radians about the target's origin.

    Returns the gicp.kernel.Motion from the start, which has matches at the step before it; steps; whether the last was
    below a tolerance. With fewer matches than search.least_matches the motion so far, not converged.
    """
    copy, terms, sums = cloud.copy, np.zeros(_TERMS * len(cloud.copy.x), np.float32), np.zeros(_SUMS)
    motion, x, y = gicp.Motion(0.0, 0.0, start_yaw, 0.0, 0.0), 0.0, 0.0
    precision = search.precision.copy()
    precision[:, 2] /= cloud.lever
    precision[2] /= cloud.lever
    steps, matched, converged = 0, 0, False
    while steps < limits.max_iterations and not converged:
        matched += _match(copy, target, motion, terms, sums, limits)
        if matched < search.least_matches:
            break
        at_place = _sums_at(cloud, target, motion, sums, limits)
        offset = x, y, cloud.lever * (motion.yaw - start_yaw)
        (step_x, step_y, step_yaw), square = _step(
            at_place, offset, matched, limits.with_yaw, precision, search.residuals_as_one
        )
        step = max(math.hypot(step_x, step_y), abs(step_yaw))
        share = min(1.0, search.longest_step / max(step, 1e-12))
        x, y = x + share * step_x, y + share * step_y
        motion = _move(motion, cloud, x, y, share * step_yaw / cloud.lever, start_yaw)
        steps += 1
        converged = step < limits.tolerance or square < search.tolerance_sigmas**2
    return motion, steps, converged


@kernel
def match(cloud, target, motion, limits):  # type: ignore[no-untyped-def]
    """Match the points of a Cloud anew where the motion since their last match may have changed it."""
    stale = gicp._find_stale(cloud.copy, _f32(motion.travel), _f32(motion.rotation))
    gicp._match(cloud.copy, target, motion, limits.max_distance, stale)


@kernel
def _match(copy, target, motion, terms, sums, limits):  # type: ignore[no-untyped-def]
    # as gicp.kernel._rematch, with the terms along normals; returns how many more points are matched
    stale = gicp._find_stale(copy, _f32(motion.travel), _f32(motion.rotation))
    changed, growth = gicp._match(copy, target, motion, limits.max_distance, stale)
    if not limits.with_yaw:
        _exchange(copy, target, limits.epsilon, changed, terms, sums)
    return growth


@kernel
def _exchange(copy, target, epsilon, count, terms, sums):  # type: ignore[no-untyped-def]
    # puts the new terms of the first `count` stale points into the sums, in place of their old ones
    s0, s1, s2, s3, s4, s9 = sums[0], sums[1], sums[2], sums[3], sums[4], sums[9]  # locals stay in registers
    for c in range(count):
        i = _u64(copy.stale[_u64(c)])
        n, t = _u64(3) * i, _u64(_TERMS) * i
        matched = _f32(copy.matches[i] >= 0)
        xx, xy, yy, fx, fy, square = along_normals.weigh(
            copy.x[i], copy.y[i], copy.z[i], copy.normals[n], copy.normals[n + _u64(1)], copy.normals[n + _u64(2)],
            target.points, target.normals, _u64(3) * _u64(max(copy.matches[i], 0)), epsilon,
        )  # fmt: skip
        xx, xy, yy, fx, fy, square = (
            matched * xx,
            matched * xy,
            matched * yy,
            matched * fx,
            matched * fy,
            matched * square,
        )
        s0 += np.float64(xx) - np.float64(terms[t])
        s1 += np.float64(xy) - np.float64(terms[t + _u64(1)])
        s2 += np.float64(yy) - np.float64(terms[t + _u64(2)])
        s3 += np.float64(fx) - np.float64(terms[t + _u64(3)])
        s4 += np.float64(fy) - np.float64(terms[t + _u64(4)])
        s9 += np.float64(square) - np.float64(terms[t + _u64(5)])
        terms[t], terms[t + _u64(1)], terms[t + _u64(2)] = xx, xy, yy
        terms[t + _u64(3)], terms[t + _u64(4)], terms[t + _u64(5)] = fx, fy, square
    sums[0], sums[1], sums[2], sums[3], sums[4], sums[9] = s0, s1, s2, s3, s4, s9


@kernel
def _sums_at(cloud, target, motion, sums, limits):  # type: ignore[no-untyped-def]
    # the sums at the place; those of `sums` are of the unmoved copy
    if limits.with_yaw:
        return along_normals.sums_with_yaw(cloud, target, motion, limits.epsilon)
    x, y, moved = motion.x, motion.y, sums.copy()
    hx, hy = sums[0] * x + sums[1] * y, sums[1] * x + sums[2] * y
    moved[3], moved[4] = sums[3] - hx, sums[4] - hy
    moved[9] = sums[9] - 2 * (sums[3] * x + sums[4] * y) + x * hx + y * hy
    return moved


@device
def _step(sums, offset, matched, with_yaw, P, residuals_as_one):  # type: ignore[no-untyped-def]
    # Eq. 5: (H / (c s^2) + P^-1) step = f / (c s^2) - P^-1 offset; without yaw the last row says that yaw stays.
    # Returns the step and its square in units of the variance that the left side says
    x, y, yaw = offset
    variance = max(sums[9] / max(matched - (3 if with_yaw else 2), 1), _LEAST_VARIANCE_M2)
    weight = 1 / (residuals_as_one * variance)
    gradient_x = weight * sums[3] - (P[0, 0] * x + P[0, 1] * y + P[0, 2] * yaw)
    gradient_y = weight * sums[4] - (P[0, 1] * x + P[1, 1] * y + P[1, 2] * yaw)
    gradient_yaw = weight * sums[8] - (P[0, 2] * x + P[1, 2] * y + P[2, 2] * yaw)
    xx, xy, yy = weight * sums[0] + P[0, 0], weight * sums[1] + P[0, 1], weight * sums[2] + P[1, 1]
    x_yaw, y_yaw, yaw_yaw = weight * sums[5] + P[0, 2], weight * sums[6] + P[1, 2], weight * sums[7] + P[2, 2]
    step = yaw_step.solve((xx, xy, yy, gradient_x, gradient_y, x_yaw, y_yaw, yaw_yaw, gradient_yaw))
    return step, step[0] * gradient_x + step[1] * gradient_y + step[2] * gradient_yaw


@device
def _move(motion, cloud, x, y, turn, start_yaw):  # type: ignore[no-untyped-def]
    # the motion about the origin that takes the centroid by (x, y) from its start, and turns the cloud by `turn` more
    yaw = motion.yaw + turn
    dc, ds = math.cos(start_yaw) - math.cos(yaw), math.sin(start_yaw) - math.sin(yaw)
    new_x, new_y = x + dc * cloud.x - ds * cloud.y, y + ds * cloud.x + dc * cloud.y
    travel = motion.travel + math.hypot(new_x - motion.x, new_y - motion.y)
    return gicp.Motion(new_x, new_y, yaw, travel, motion.rotation + abs(turn))
