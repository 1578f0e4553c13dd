"""What a measure of a map's consistency says of each of its cells."""

from typing import NamedTuple

import numpy as np


class Cells(NamedTuple):
    """The k cells of a map that two or more submaps share, by column and then row."""

    column: np.ndarray  # (k,) int64, counted eastwards: column 0 begins at the map frame's origin
    row: np.ndarray  # (k,) int64, northwards
    error_m: np.ndarray  # (k,) of the worst pair of submaps

    @property
    def rms(self) -> float:
        """Return the root mean square of the errors, metres; NaN of none."""
        return rms(self.error_m)


def rms(errors: np.ndarray) -> float:
    """Return the root mean square of some cells' errors (k,); NaN of none."""
    return float(np.sqrt(np.mean(errors**2))) if len(errors) else float("nan")
