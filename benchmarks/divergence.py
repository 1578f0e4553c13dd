"""One submap's registrations by our kernel and by the slow reference, and why two of them may end apart."""

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.spatial import cKDTree

from pointnetkl.registration import gicp, reference

NEAR_M = 1e-3  # results under this apart are the same
STEP_M = 1e-5  # steps that differ by less are the same
ROUNDING_M = 1e-4  # float32 places a point 500 m away within 3e-5 m: so much may a step differ, or a tie be broken
_NONE = np.zeros(2)


@dataclass(frozen=True)
class Apart:
    """A run that ended elsewhere than the reference's."""

    run: int
    apart_m: float
    why: str
    onward_m: float  # that the reference goes from where ours ended
    steps: int  # ours took
    differing_steps: int  # that the reference, from the same place, would have taken otherwise, by STEP_M or more
    largest_step_m: float  # difference of one step
    ties: int  # target points about as near as the nearest, when that step was taken


class Pair:
    """A source and a target, prepared for the kernel and for the reference."""

    def __init__(self, source: np.ndarray, target: np.ndarray, settings: gicp.Settings):
        """Prepare clouds (n, 3) and (m, 3).

        Raises:
            GicpError: a cloud cannot be registered.
        """
        self.settings = settings
        self.source, self.target = gicp.prepare(source, settings), gicp.prepare(target, settings)
        self._target = reference.Cloud(self.target.points, reference.normals(self.target.points, self.target.lists))
        self._tree = cKDTree(self.target.points)

    def ours(self, moves: np.ndarray, noise: gicp.Noise, settings: gicp.Settings) -> gicp.Registrations:
        """Register the copies that moves (b, 2) and the noise make of the source."""
        return gicp.register_noisy(self.source, self.target, moves, noise, settings)

    def by_reference(self, moves: np.ndarray, noise: gicp.Noise) -> tuple[np.ndarray, np.ndarray]:
        """Return the reference's translations (b, 2) for the same copies, and whether each converged (b,)."""
        found = [
            self._register(self._copy(move, replace(noise, first=noise.first + i)), _NONE, self.settings)
            for i, move in enumerate(moves)
        ]
        return np.stack([each[0] for each in found]), np.array([each[2] for each in found])

    def explain(self, move: np.ndarray, noise: gicp.Noise, theirs: np.ndarray) -> Apart:
        """Return why run `noise.first` ended elsewhere than the reference, which ended at `theirs` (2,).

        Every step of ours is held against the step that the reference takes from the same place; then the reference
        goes on from where ours ended.
        """
        copy, ours = self._copy(move, noise), self.ours(move[None], noise, self.settings)
        steps = int(ours.iterations[0])
        path = [_NONE] + [
            self.ours(move[None], noise, replace(self.settings, max_iterations=k)).T_target_copy.translation[0]
            for k in range(1, steps + 1)
        ]
        one = replace(self.settings, max_iterations=1)
        differences = np.array([np.linalg.norm(b - a - self._register(copy, a, one)[0]) for a, b in pairwise(path)])
        further, _, settled = self._register(copy, path[-1], self.settings)
        why = _why(bool(ours.converged[0]) and settled, float(np.linalg.norm(further)), float(differences.max()))
        worst = int(differences.argmax())
        return Apart(
            run=noise.first,
            apart_m=float(np.linalg.norm(path[-1] - theirs)),
            why=why,
            onward_m=float(np.linalg.norm(further)),
            steps=steps,
            differing_steps=int(np.sum(differences >= STEP_M)),
            largest_step_m=float(differences[worst]),
            ties=self._ties(copy.points + np.append(path[worst], 0)),
        )

    def _copy(self, move: np.ndarray, noise: gicp.Noise) -> reference.Cloud:
        points = self.source.points + np.append(move, 0) + noise.draw(1, len(self.source.points))[0]
        return reference.Cloud(points, reference.normals(points, self.source.lists))

    def _register(
        self, copy: reference.Cloud, place: np.ndarray, settings: gicp.Settings
    ) -> tuple[np.ndarray, np.ndarray, bool]:
        moved = copy._replace(points=copy.points + np.append(place, 0))
        T, information, settled = reference.register(moved, self._target, settings)
        return np.asarray(T.translation), information, settled

    def _ties(self, points: np.ndarray) -> int:
        first, second = self._tree.query(points, 2)[0].T
        return int(np.sum(second - first < ROUNDING_M))


def _why(settled: bool, onward_m: float, largest_step_m: float) -> str:
    if not settled:
        return "goes round in a circle"
    if onward_m < NEAR_M:
        return "two solutions"  # the reference stays where ours ended
    # each step is the reference's own, but what is left of it changes a match, and that the next step, and so on
    return "rounding" if largest_step_m < ROUNDING_M else "unexplained"
