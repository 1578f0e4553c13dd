"""Soundings at the corrected track: each moves and turns with its ping."""

import numpy as np
import pandas as pd

from pointnetkl.correction.result import CorrectionError


def renavigated(part: pd.DataFrame, track: pd.DataFrame) -> np.ndarray:
    """Return the corrected places (n, 2) of soundings (survey.SOUNDINGS), metres in the map frame.

    A sounding turns about its ping, and moves with it. Without a track (result.TRACK) it stays where it is.

    Raises:
        CorrectionError: a sounding is of a ping that the track lacks.
    """
    return moved(places(part), rows_of(part, track), track)


def places(part: pd.DataFrame) -> np.ndarray:
    """Return the places (n, 2) of soundings before the correction, metres in the map frame."""
    return np.column_stack([part[name].to_numpy(np.float64) for name in ("x_m", "y_m")])


def rows_of(part: pd.DataFrame, track: pd.DataFrame) -> np.ndarray:
    """Return the row (n,) of the track that is each sounding's ping; -1 for all where there is no track.

    Raises:
        CorrectionError: a sounding is of a ping that the track lacks.
    """
    ping, pings = part["ping"].to_numpy(), track["ping"].to_numpy()
    if not len(pings):
        return np.full(len(ping), -1)
    rows = np.minimum(np.searchsorted(pings, ping), len(pings) - 1)
    if not np.array_equal(pings[rows], ping):
        lost = int(ping[pings[rows] != ping][0])
        raise CorrectionError(f"the track lacks ping {lost}, of which there are soundings; run ingest again")
    return rows


def moved(before: np.ndarray, rows: np.ndarray, track: pd.DataFrame) -> np.ndarray:
    """Return the corrected places (n, 2) of soundings at `before` (n, 2), whose pings are rows (n,) of the track."""
    if track.empty:
        return before
    east, north = (before - pings_at(rows, track)).T
    yaw = track["moved_yaw_rad"].to_numpy()[rows]
    # the turn less the identity, so that a ping that does not turn leaves no rounding
    versine, sine = np.cos(yaw) - 1.0, np.sin(yaw)
    shift = np.column_stack([track[name].to_numpy()[rows] for name in ("moved_x_m", "moved_y_m")])
    return before + shift + np.column_stack([versine * east - sine * north, sine * east + versine * north])


def pings_at(rows: np.ndarray, track: pd.DataFrame) -> np.ndarray:
    """Return the places (n, 2) of rows (n,) of the track before the correction, metres."""
    return np.column_stack([track[name].to_numpy()[rows] for name in ("x_m", "y_m")])
