"""GICP (Segal 2009) constrained to x and y, or x, y and yaw: prepare clouds, register one or many noisy copies."""

from pointnetkl.gicp.noise import Noise
from pointnetkl.gicp.registration import (
    Cloud,
    GicpError,
    Registration,
    Registrations,
    Settings,
    prepare,
    register,
    register_noisy,
)

__all__ = [
    "Cloud",
    "GicpError",
    "Noise",
    "Registration",
    "Registrations",
    "Settings",
    "prepare",
    "register",
    "register_noisy",
]
