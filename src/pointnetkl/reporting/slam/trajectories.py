"""Figure of trajectories: as they are, on one scale, and the solved ones' displacements from the truth."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from pointnetkl.registration.covariance import catalogue
from pointnetkl.registration.covariance.catalogue import GT, TRUTH
from pointnetkl.reporting import paper
from pointnetkl.reporting.drawing import plots, sheet
from pointnetkl.slam.graph import trajectory_error

_ACROSS, _HEADING_IN = 7, 0.22
_AS_THEY_ARE = (*catalogue.REFERENCES, catalogue.MONTE_CARLO, catalogue.POINTNETKL, catalogue.NETWORK)
_FLATTEST = 0.45  # least height of a panel over its width: the text in it needs room
_REACH = 0.08  # length of the usual method's largest displacement on the map, over the map's longer side


@dataclass(frozen=True)
class Tracks:
    """One survey's trajectories: positions (n, 3) in metres by name, and the nodes (e, 2) that loop closures join."""

    positions: Mapping[str, np.ndarray]
    closures: np.ndarray

    @property
    def reference(self) -> str:
        """Return the trajectory to compare the others with: the truth, or GT where the truth is not known."""
        return TRUTH if TRUTH in self.positions else GT

    def displacements(self, name: str) -> np.ndarray:
        """Return a trajectory's displacements (n, 2) from the reference after alignment in SE(2), metres."""
        reference = self.positions[self.reference]
        return np.asarray(trajectory_error.align_se2(self.positions[name], reference) - reference)[:, :2]

    def plan(self, name: str) -> np.ndarray:
        """Return a trajectory seen from above, (n, 2) metres."""
        return self.positions[name][:, :2]

    @property
    def solved(self) -> list[str]:
        """Return the names of the trajectories solved with a method, in their order."""
        return [name for name in self.positions if name not in catalogue.REFERENCES]


def trajectories(surveys: Mapping[str, Tracks]) -> Figure:
    """Draw each survey's trajectories on one scale with their loop closures; below, each method's displacements.

    A method's panel has the reference in grey. The solved trajectory is aligned with it in SE(2), and its displacements
    are drawn magnified, by the factor in the heading, and coloured by their length.
    """
    heights = {name: _heights(tracks) for name, tracks in surveys.items()}
    figure, top = sheet.sheet(0.1 + sum(map(sum, heights.values()))), 0.05
    for name, tracks in surveys.items():
        first, others = heights[name]
        sheet.write(figure, 0.1, top, f"{paper.title(name)}: as they are, loop closures in orange", 10)
        _as_they_are(figure, tracks, top + _HEADING_IN)
        sheet.write(figure, 0.1, top + first, _heading(tracks), 9)
        _displaced(figure, tracks, top + first + _HEADING_IN)
        top += first + others
    return figure


def magnification(tracks: Tracks) -> float:
    """Return the round factor by which displacements from the reference fill the room in a map's panel."""
    extent = float(np.ptp(tracks.plan(tracks.reference), axis=0).max())
    return max(1.0, sheet.round_below(_REACH * extent / _usual(tracks)))


def _usual(tracks: Tracks) -> float:
    """Return the median over methods of the largest displacement, metres: one that failed must not set the scale."""
    largest = [_lengths(tracks.displacements(name)).max() for name in tracks.solved]
    return max(float(np.median(largest)), 1e-3) if largest else 1e-3


def _heights(tracks: Tracks) -> tuple[float, float]:
    """Return the heights, inches with headings, of the trajectories as they are and of the displacements."""
    first = sheet.grid_height(_whole(tracks), len(_shown(tracks)), _ACROSS)
    others = sheet.grid_height(_near(tracks), len(tracks.solved), _ACROSS)
    return first + _HEADING_IN + 0.05, others + _HEADING_IN + 0.15


def _heading(tracks: Tracks) -> str:
    reference = "GT" if tracks.reference == GT else tracks.reference
    words = f"aligned with {reference}, displacement × {magnification(tracks):g}; number: its root mean square"
    return f"{words}; colour: 0 (dark) to {_usual(tracks):.2g} m or more (yellow)"


def _shown(tracks: Tracks) -> list[str]:
    return [name for name in _AS_THEY_ARE if name in tracks.positions]


def _as_they_are(figure: Figure, tracks: Tracks, top: float) -> None:
    names, corners = _shown(tracks), _whole(tracks)
    grid = sheet.grid(figure, top, corners, len(names), _ACROSS)
    for i, name in enumerate(names):
        offset, frame = grid.place(i, paper.title(name))
        plan = tracks.plan(name) + offset
        grid.draw(Line2D(*plan.T, color=plots.BLUE, linewidth=0.9), frame)
        grid.draw(LineCollection(list(plan[tracks.closures]), colors=plots.ORANGE, linewidths=0.6), frame)
    sheet.scale_bar(grid.axes, corners)


def _displaced(figure: Figure, tracks: Tracks, top: float) -> None:
    corners, factor, longest = _near(tracks), magnification(tracks), _usual(tracks)
    grid = sheet.grid(figure, top, corners, len(tracks.solved), _ACROSS)
    for i, name in enumerate(tracks.solved):
        offset, frame = grid.place(i, paper.title(name))
        displacements, reference = tracks.displacements(name), tracks.plan(tracks.reference) + offset
        moved, lengths = reference + factor * displacements, _lengths(displacements)
        grid.draw(Line2D(*reference.T, color="#cccccc", linewidth=0.6), frame)
        ends = list(np.stack([moved[:-1], moved[1:]], axis=1))
        grid.draw(LineCollection(ends, array=lengths[1:], cmap="plasma", clim=(0, longest), linewidths=1.2), frame)
        right = corners[1] + offset - 0.04 * grid.inch
        grid.axes.text(right[0], right[1], f"{np.sqrt(np.mean(lengths**2)):.3g} m", fontsize=7, ha="right", va="top")
    sheet.scale_bar(grid.axes, corners)


def _whole(tracks: Tracks) -> np.ndarray:
    # one scale a survey, or a turned map would look like a small error
    return sheet.limits(np.concatenate([tracks.plan(name) for name in _shown(tracks)]), _FLATTEST)


def _near(tracks: Tracks) -> np.ndarray:
    reference = tracks.plan(tracks.reference)
    room = _REACH * np.ptp(reference, axis=0).max()
    return sheet.limits(np.concatenate([reference - room, reference + room]), _FLATTEST)


def _lengths(vectors: np.ndarray) -> np.ndarray:
    return np.asarray(np.linalg.norm(vectors, axis=1))
