"""A pair of clouds registered to its most probable place, and what its matches say of that: docs/closures.md."""

from pointnetkl.registration.pair import covariance, factor
from pointnetkl.registration.pair.factor import Factor
from pointnetkl.registration.pair.forces import Forces, at
from pointnetkl.registration.pair.registration import Estimate, register
from pointnetkl.registration.pair.settings import METHODS, PairError, Settings

__all__ = ["METHODS", "Estimate", "Factor", "Forces", "PairError", "Settings", "at", "covariance", "factor", "register"]
