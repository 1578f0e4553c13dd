"""What a registration does on average: Monte Carlo's outcome from the submap's ground, in milliseconds.

Every matching of GICP (Segal 2009) moves the copy by a force over a stiffness, and both are sums over the submap's
points that depend on little but the offset at which the copy lies. So they are tabulated once, over offsets, from a
raster of the ground: `forces` has what slopes do, and what points do that match their nearest ones. Hundreds of
copies then run down these tables (`settling`) in the time of one registration, and where they end is the covariance.
The registration's noise enters as its mean effect on forces; what it does to matches is left out.
"""

from pointnetkl.models.mean_field.description import Conditions, Description, MeanFieldError, conditions, describe

__all__ = ["Conditions", "Description", "MeanFieldError", "conditions", "describe"]
