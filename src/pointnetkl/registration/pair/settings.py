"""How a pair is registered: by GICP, as the paper does, or to the most probable place (MAP)."""

from dataclasses import asdict, dataclass, fields
from typing import Self

from pointnetkl.registration import gicp
from pointnetkl.workflow.errors import PointNetKLError
from pointnetkl.workflow.parameters import require_positive

METHODS = ("gicp", "map")


class PairError(PointNetKLError):
    """A pair of clouds cannot be registered, or its variance cannot be told."""


@dataclass(frozen=True)
class Settings(gicp.Settings):
    """Section `registration` of the parameters, with the method of registration.

    They are settings of GICP too. Labels take `as_gicp`: the name of a shard hangs on every field.

    Raises:
        ValueError: a setting is out of its range.
    """

    method: str = "gicp"  # gicp: the paper; map: along normals alone, with the start's prior as a factor
    map_steps: int = 15  # at most; on flat ground more change an rms error of 0.51 m to 0.49 m
    residuals_as_one: float = 8.0  # neighbours' residuals are alike: so many count as one while the place is searched
    longest_step_spacings: float = 2.0  # of the search, in point spacings
    # converged, too, when a step is shorter than so many sigmas of the place, as the search sees them; 0: never. 0.03
    # halves the steps on flat ground and adds 1 % to an rms error of 0.4 m
    tolerance_sigmas: float = 0.03

    @classmethod
    def of(cls, registration: gicp.Settings, method: str) -> Self:
        """Return settings with a method, and all else as GICP's."""
        return cls(**{**asdict(registration), "method": method})

    @property
    def as_gicp(self) -> gicp.Settings:
        """Return the fields that are GICP's own."""
        return gicp.Settings(**{field.name: getattr(self, field.name) for field in fields(gicp.Settings)})

    def __post_init__(self) -> None:
        """Refuse what makes no sense."""
        super().__post_init__()
        if self.method not in METHODS:
            raise ValueError(f"method is {self.method!r}, must be {METHODS[0]} or {METHODS[1]}")
        require_positive(self, "map_steps", "residuals_as_one", "longest_step_spacings")
        if self.tolerance_sigmas < 0:
            raise ValueError(f"tolerance_sigmas is {self.tolerance_sigmas:g}, must be 0 or above")
