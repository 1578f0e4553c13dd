"""GICP (Segal 2009) constrained to x and y: prepare clouds, register one onto another, or many noisy copies."""

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
    "Registration",
    "Registrations",
    "Settings",
    "prepare",
    "register",
    "register_noisy",
]
