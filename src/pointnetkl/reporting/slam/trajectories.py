"""Trajectories of the SLAM benchmark: as they are on one scale, and how far the solved ones are from the truth."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from pointnetkl.reporting import paper
from pointnetkl.reporting.drawing import plots, sheet
from pointnetkl.slam.graph import trajectory_error

_ACROSS, _HEADING_IN = 7, 0.22
_AS_THEY_ARE = ("truth", "gt", "navigation", "corrupted", "monte_carlo", "pointnetkl", "network")
_NOT_SOLVED = ("truth", "gt", "navigation", "corrupted")
_FLATTEST = 0.45  # height of a panel by its width: the text in it needs room
_REACH = 0.08  # of the map's longer side, that the usual method's largest displacement is drawn as


@dataclass(frozen=True)
class Tracks:
    """One survey's trajectories: (n, 3) positions in metres by name, and the (e, 2) nodes that closures join."""

    positions: Mapping[str, np.ndarray]
    closures: np.ndarray

    @property
    def reference(self) -> str:
        """Return what the others are compared with: the truth, or GT where that is not known."""
        return "truth" if "truth" in self.positions else "gt"

    def displacements(self, which: str) -> np.ndarray:
        """Return how far a trajectory is from the reference, (n, 2) metres, turned and moved to fit it best."""
        reference = self.positions[self.reference]
        return np.asarray(trajectory_error.align_se2(self.positions[which], reference) - reference)[:, :2]

    def plan(self, which: str) -> np.ndarray:
        """Return a trajectory seen from above, (n, 2) metres."""
        return self.positions[which][:, :2]

    @property
    def solved(self) -> list[str]:
        """Return the methods' names, in their order."""
        return [name for name in self.positions if name not in _NOT_SOLVED]


def trajectories(surveys: Mapping[str, Tracks]) -> Figure:
    """Draw each survey's trajectories on one scale with their loop closures; below, every method's displacement.

    A method's panel has the reference in grey and, coloured by its length, so many times the displacement from it of
    the solved trajectory, turned and moved to fit the reference best: the heading says how many.
    """
    heights = {name: _heights(tracks) for name, tracks in surveys.items()}
    figure, top = sheet.sheet(0.1 + sum(sum(each) for each in heights.values())), 0.05
    for name, tracks in surveys.items():
        first, others = heights[name]
        sheet.write(figure, 0.1, top, f"{paper.title(name)}: as they are, loop closures in orange", 10)
        _as_they_are(figure, tracks, top + _HEADING_IN)
        sheet.write(figure, 0.1, top + first, _heading(tracks), 9)
        _displaced(figure, tracks, top + first + _HEADING_IN)
        top += first + others
    return figure


def magnification(tracks: Tracks) -> float:
    """Return the round factor that makes displacements from the reference as large as a map's panel can show."""
    extent = float(np.ptp(tracks.plan(tracks.reference), axis=0).max())
    return max(1.0, sheet.round_below(_REACH * extent / _usual(tracks)))


def _usual(tracks: Tracks) -> float:
    """Return the median over methods of the largest displacement, metres: one that gave up must not set the scale."""
    largest = [_lengths(tracks.displacements(name)).max() for name in tracks.solved]
    return max(float(np.median(largest)), 1e-3) if largest else 1e-3


def _heights(tracks: Tracks) -> tuple[float, float]:
    """Return how high, in inches, the trajectories as they are and the displacements are, with their headings."""
    first = sheet.grid_height(_whole(tracks), len(_shown(tracks)), _ACROSS)
    others = sheet.grid_height(_near(tracks), len(tracks.solved), _ACROSS)
    return first + _HEADING_IN + 0.05, others + _HEADING_IN + 0.15


def _heading(tracks: Tracks) -> str:
    said = "GT" if tracks.reference == "gt" else tracks.reference
    words = f"aligned with {said}, displacement × {magnification(tracks):g}; number: its root mean square"
    return f"{words}; colour: 0 (dark) to {_usual(tracks):.2g} m or more (yellow)"


def _shown(tracks: Tracks) -> list[str]:
    return [which for which in _AS_THEY_ARE if which in tracks.positions]


def _as_they_are(figure: Figure, tracks: Tracks, top: float) -> None:
    shown, corners = _shown(tracks), _whole(tracks)
    grid = sheet.grid(figure, top, corners, len(shown), _ACROSS)
    for i, which in enumerate(shown):
        offset, frame = grid.place(i, paper.title(which))
        plan = tracks.plan(which) + offset
        grid.draw(Line2D(*plan.T, color=plots.BLUE, linewidth=0.9), frame)
        grid.draw(LineCollection(list(plan[tracks.closures]), colors=plots.ORANGE, linewidths=0.6), frame)
    sheet.scale_bar(grid.axes, corners)


def _displaced(figure: Figure, tracks: Tracks, top: float) -> None:
    corners, factor, most = _near(tracks), magnification(tracks), _usual(tracks)
    grid = sheet.grid(figure, top, corners, len(tracks.solved), _ACROSS)
    for i, which in enumerate(tracks.solved):
        offset, frame = grid.place(i, paper.title(which))
        off, reference = tracks.displacements(which), tracks.plan(tracks.reference) + offset
        moved, lengths = reference + factor * off, _lengths(off)
        grid.draw(Line2D(*reference.T, color="#cccccc", linewidth=0.6), frame)
        ends = list(np.stack([moved[:-1], moved[1:]], axis=1))
        grid.draw(LineCollection(ends, array=lengths[1:], cmap="plasma", clim=(0, most), linewidths=1.2), frame)
        right = corners[1] + offset - 0.04 * grid.inch
        grid.axes.text(right[0], right[1], f"{np.sqrt(np.mean(lengths**2)):.3g} m", fontsize=7, ha="right", va="top")
    sheet.scale_bar(grid.axes, corners)


def _whole(tracks: Tracks) -> np.ndarray:
    # one scale a survey, or the eye would take a turned map for a small error
    return sheet.limits(np.concatenate([tracks.plan(which) for which in _shown(tracks)]), _FLATTEST)


def _near(tracks: Tracks) -> np.ndarray:
    reference = tracks.plan(tracks.reference)
    room = _REACH * np.ptp(reference, axis=0).max()
    return sheet.limits(np.concatenate([reference - room, reference + room]), _FLATTEST)


def _lengths(vectors: np.ndarray) -> np.ndarray:
    return np.asarray(np.linalg.norm(vectors, axis=1))
