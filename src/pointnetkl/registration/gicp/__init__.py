"""GICP (Segal 2009) constrained to x and y, or x, y and yaw: prepare clouds, register one or many noisy copies."""

from pointnetkl.registration.gicp.cloud import Cloud, GicpError, Part, Settings, Source, part, prepare
from pointnetkl.registration.gicp.linearised import Linearised, linearise, solve
from pointnetkl.registration.gicp.noise import Noise
from pointnetkl.registration.gicp.registration import Registration, Registrations, register, register_noisy

__all__ = [
    "Cloud",
    "GicpError",
    "Linearised",
    "Noise",
    "Part",
    "Registration",
    "Registrations",
    "Settings",
    "Source",
    "linearise",
    "part",
    "prepare",
    "register",
    "register_noisy",
    "solve",
]
