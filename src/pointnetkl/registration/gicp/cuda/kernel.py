"""The kernel for an NVIDIA GPU: a thread block draws a noisy copy, estimates its normals and aligns it alone.

It does what kernel.register_noisy does in x and y, with the same device functions. A block keeps the state of its copy
in the GPU's memory, in an order in which neighbouring threads read neighbouring numbers. No sum depends on timing: the
points to be searched are listed in their own order, and block-wide sums are trees of fixed shape. So a run has the same
result in every launch.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import cuda, float64
from numba.core import config

from pointnetkl.registration.gicp import noise, normals, weights
from pointnetkl.registration.gicp.cuda import matching
from pointnetkl.registration.gicp.device import device

_f32, _u64 = np.float32, np.uint64
_NEVER = _f32(1e30)  # metres
# Six blocks' registers on a multiprocessor: what is spilled is used once in an iteration. The simulator has none.
_OPTIONS = {"fastmath": True} | ({} if config.ENABLE_CUDASIM else {"max_registers": 80})


class Source(NamedTuple):
    """The cloud to be copied."""

    points: np.ndarray  # (3, n) float32 metres, in the target's axes
    lists: np.ndarray  # (k n,) uint32, the n points' first neighbours, their second ones ...: those of a point ascend


class Room(NamedTuple):
    """The state of every block's copy; the room of a single block has no first axis."""

    points: np.ndarray  # (blocks, 3, n) float32 metres, before the copy is moved
    normals: np.ndarray  # (blocks, 3, n) float32
    terms: np.ndarray  # (blocks, 5, n) float32, a point's part of the sums
    matches: np.ndarray  # (blocks, n) int32, -1: none
    deadlines: np.ndarray  # (blocks, share threads) float32 metres; point t share + k, of thread t, at k threads + t
    stale: np.ndarray  # (blocks, 2, n) int32, the points to be searched now, and where in `deadlines` theirs stand


class Outcomes(NamedTuple):
    """How b runs ended."""

    translations: np.ndarray  # (b, 2) float64 metres
    iterations: np.ndarray  # (b,) int32
    converged: np.ndarray  # (b,) bool
    started: np.ndarray  # (1,) int32, runs: each block takes the next one


@cuda.jit(**_OPTIONS)
def register_noisy(source, target, moves, draws, limits, room, outcomes):  # type: ignore[no-untyped-def]
    """Register copies of a Source, each moved by (x, y) of moves (b, 2) and noise, onto a target.

    The target comes from cuda.matching.interleaved. A block has a power of two of threads, `shared_bytes` of shared
    memory, and its part of the Room.
    """
    shared = cuda.shared.array(0, float64)
    b = cuda.blockIdx.x
    own = Room(room.points[b], room.normals[b], room.terms[b], room.matches[b], room.deadlines[b], room.stale[b])
    run = _next(outcomes.started, shared)
    while run < len(moves):
        _make_copy(source, moves[run, 0], moves[run, 1], draws, run, own)
        x, y, iterations, converged = _align(own, target, limits, shared)
        if cuda.threadIdx.x == 0:
            outcomes.translations[run, 0], outcomes.translations[run, 1] = x, y
            outcomes.iterations[run], outcomes.converged[run] = iterations, converged
        run = _next(outcomes.started, shared)


def shared_bytes(threads: int) -> int:
    """Return the bytes of shared memory that a block of so many threads needs."""
    return 8 * weights.TERMS * (threads + 1)


@cuda.jit(device=True)
def _next(started, shared):  # type: ignore[no-untyped-def]
    cuda.syncthreads()
    if cuda.threadIdx.x == 0:
        shared[0] = cuda.atomic.add(started, 0, 1)
    cuda.syncthreads()
    run = int(shared[0])
    cuda.syncthreads()
    return run


@cuda.jit(device=True)
def _make_copy(source, by_x, by_y, draws, run, own):  # type: ignore[no-untyped-def]
    first, low, high, sigma = draws
    n, share = source.points.shape[1], _share(own)
    neighbours = len(source.lists) // n
    thread, threads = cuda.threadIdx.x, cuda.blockDim.x
    for k in range(share):
        own.deadlines[_u64(k * threads + thread)] = -1 if thread * share + k < n else _NEVER
    px, py, pz = own.points[0], own.points[1], own.points[2]
    for point in range(thread, n, threads):
        i = _u64(point)
        x, y, z = noise.normal3(point, first + run, low, high)
        px[i] = source.points[0, i] + sigma * x + by_x
        py[i] = source.points[1, i] + sigma * y + by_y
        pz[i] = source.points[2, i] + sigma * z
        own.matches[i] = -1
        for term in range(weights.TERMS):
            own.terms[term, i] = 0
    cuda.syncthreads()
    for point in range(thread, n, threads):
        i = _u64(point)
        own.normals[0, i], own.normals[1, i], own.normals[2, i] = _normal(px, py, pz, source.lists, neighbours, i)


@device
def _normal(px, py, pz, lists, neighbours, i):  # type: ignore[no-untyped-def]
    # the copy's own scatter about the point, because reading 3 numbers of a neighbour costs more here than adding 9
    sx = sy = sz = xx = xy = xz = yy = yz = zz = _f32(0)
    k, entry = 0, i
    while k < neighbours:  # unlike a range, unrolled without a check in each turn
        j = _u64(lists[entry])
        x, y, z = px[j] - px[i], py[j] - py[i], pz[j] - pz[i]
        sx, sy, sz = sx + x, sy + y, sz + z
        xx, xy, xz = xx + x * x, xy + x * y, xz + x * z
        yy, yz, zz = yy + y * y, yz + y * z, zz + z * z
        k += 1
        entry += _u64(len(px))
    share = _f32(1) / _f32(neighbours)
    mx, my, mz = sx * share, sy * share, sz * share
    return normals.normal(xx - sx * mx, xy - sx * my, xz - sx * mz, yy - sy * my, yz - sy * mz, zz - sz * mz)


@cuda.jit(device=True)
def _align(own, target, limits, shared):  # type: ignore[no-untyped-def]
    # kernel.align in x and y; every thread takes the same decisions from the same sums
    x = y = travel = 0.0
    iterations, converged = 0, False
    _clear_sums(shared)
    while iterations < limits.max_iterations and not converged:
        count = _list_stale(own, _f32(travel), shared)
        sums = _add_to_sums(_rematch(own, target, limits, count, x, y, _f32(travel)), shared)
        if sums[0] < 0.25:  # M is at least I / 2 for every match: there is none
            return 0.0, 0.0, iterations, False
        to_x, to_y = weights.solve(sums)
        step = math.sqrt((to_x - x) ** 2 + (to_y - y) ** 2)
        x, y, travel = to_x, to_y, travel + step
        iterations += 1
        converged = step < limits.tolerance
    return x, y, iterations, converged


@cuda.jit(device=True)
def _list_stale(own, travel, shared):  # type: ignore[no-untyped-def]
    # Lists the points whose match the motion so far may have changed, in ascending order; returns how many.
    thread, threads, share = cuda.threadIdx.x, cuda.blockDim.x, _share(own)
    count = k = 0
    while k < share:
        count += not travel < own.deadlines[_u64(k * threads + thread)]
        k += 1
    place, total = _place(count, shared)
    k = 0
    while k < share:
        slot = k * threads + thread
        if not travel < own.deadlines[_u64(slot)]:
            own.stale[0, _u64(place)], own.stale[1, _u64(place)] = thread * share + k, slot
            place += 1
        k += 1
    cuda.syncthreads()
    return total


@cuda.jit(device=True)
def _share(own):  # type: ignore[no-untyped-def]
    return own.deadlines.shape[0] // cuda.blockDim.x


@cuda.jit(device=True)
def _place(count, shared):  # type: ignore[no-untyped-def]
    # the sum of the counts of the threads before this one, and of all (Hillis and Steele 1986)
    thread, threads = cuda.threadIdx.x, cuda.blockDim.x
    shared[thread] = count
    cuda.syncthreads()
    span = 1
    while span < threads:
        before = shared[thread - span] if thread >= span else 0.0
        cuda.syncthreads()
        shared[thread] += before
        cuda.syncthreads()
        span *= 2
    place = int(shared[thread]) - count, int(shared[threads - 1])
    cuda.syncthreads()
    return place


@cuda.jit(device=True)
def _rematch(own, target, limits, count, x, y, travel):  # type: ignore[no-untyped-def]
    # Searches the listed points; returns how this thread's changed matches change the sums.
    xx = xy = yy = gx = gy = 0.0
    tx, ty = _f32(x), _f32(y)
    for s in range(cuda.threadIdx.x, count, cuda.blockDim.x):
        i = _u64(own.stale[0, _u64(s)])
        px, py, pz = own.points[0, i], own.points[1, i], own.points[2, i]
        near, near_m, other_m = matching.nearest(px + tx, py + ty, pz, target, limits.max_distance)
        own.deadlines[_u64(own.stale[1, _u64(s)])] = _f32(0.5) * (other_m - near_m) - target.margin + travel
        if near != own.matches[i]:
            own.matches[i] = near
            new = _weigh(px, py, pz, own.normals[0, i], own.normals[1, i], own.normals[2, i], target, near, limits)
            old = own.terms[0, i], own.terms[1, i], own.terms[2, i], own.terms[3, i], own.terms[4, i]
            own.terms[0, i], own.terms[1, i], own.terms[2, i], own.terms[3, i], own.terms[4, i] = new
            xx, xy, yy = xx + (new[0] - old[0]), xy + (new[1] - old[1]), yy + (new[2] - old[2])
            gx, gy = gx + (new[3] - old[3]), gy + (new[4] - old[4])
    return xx, xy, yy, gx, gy


@device
def _weigh(px, py, pz, ax, ay, az, target, match, limits):  # type: ignore[no-untyped-def]
    xx = xy = yy = gx = gy = _f32(0)
    if match >= 0:
        xx, xy, yy, gx, gy = weights.weigh(
            px, py, pz, ax, ay, az, target.points, target.normals, _u64(3) * _u64(match), limits.epsilon
        )
    return xx, xy, yy, gx, gy


@cuda.jit(device=True)
def _clear_sums(shared):  # type: ignore[no-untyped-def]
    # M_xx, M_xy, M_yy, (M d)_x, (M d)_y stand behind what the threads have of the shared memory
    if cuda.threadIdx.x < weights.TERMS:
        shared[weights.TERMS * cuda.blockDim.x + cuda.threadIdx.x] = 0
    cuda.syncthreads()


@cuda.jit(device=True)
def _add_to_sums(changes, shared):  # type: ignore[no-untyped-def]
    thread, half, kept = cuda.threadIdx.x, cuda.blockDim.x // 2, weights.TERMS * cuda.blockDim.x
    own = weights.TERMS * thread
    shared[own], shared[own + 1], shared[own + 2], shared[own + 3], shared[own + 4] = changes
    cuda.syncthreads()
    while half > 0:
        if thread < half:
            for term in range(weights.TERMS):
                shared[own + term] += shared[own + weights.TERMS * half + term]
        cuda.syncthreads()
        half //= 2
    if thread < weights.TERMS:
        shared[kept + thread] += shared[thread]
    cuda.syncthreads()
    return shared[kept], shared[kept + 1], shared[kept + 2], shared[kept + 3], shared[kept + 4]
