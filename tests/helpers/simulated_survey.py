"""Simulated surveys for tests: the settings of params.yaml on one short line, and a vehicle without noise."""

import dataclasses
from pathlib import Path

import numpy as np
import pandas as pd

from pointnetkl import simulation
from pointnetkl.simulation import seabed, vehicle
from pointnetkl.workflow import parameters

PARAMS = Path(__file__).parents[2] / "params.yaml"


def short_line(**changes: object) -> simulation.Settings:
    """Return borno_8 of params.yaml on one short line, changed."""
    settings = parameters.read(PARAMS, "simulate.borno_8", simulation.Settings)
    layout = vehicle.Layout(
        lines=1, line_length_m=60.0, line_spacing_m=40.0, start_jitter_m=0.0, repeat_m=0.0, azimuth_deg=0.0
    )
    return dataclasses.replace(settings, **({"layout": layout, "altitude_m": 30.0} | changes))


def quiet_vehicle(**sonar_changes: float) -> vehicle.Settings:
    """Return the Hugin of params.yaml without sway, noise or drift, its sonar changed."""
    settings = parameters.read(PARAMS, "vehicles.hugin", vehicle.Settings)
    quiet = {"noise_m": 0.0, "dropouts": 0.0, "outliers": 0.0}
    return vehicle.Settings(
        speed_mps=settings.speed_mps,
        attitude=vehicle.Attitude(0.0, 0.0, 0.0, 10.0, 0.0, 0.0),
        navigation=vehicle.Navigation(0.0, 0.0, 0.0, 100.0),
        sonar=dataclasses.replace(settings.sonar, **(quiet | sonar_changes)),
    )


def sail(
    settings: simulation.Settings, vehicle_settings: vehicle.Settings, terrain: seabed.Seabed
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Return all raw soundings of a survey, and its true trajectory."""
    lines = list(simulation.survey(settings, vehicle_settings, terrain))
    raw, truth = (pd.concat([getattr(line, part) for line in lines], ignore_index=True) for part in ("raw", "truth"))
    return raw, truth


def georeferenced(raw: pd.DataFrame) -> np.ndarray:
    """Return the soundings (n, 3) in projected coordinates, as any reader of the format must place them."""
    north, east = np.cos(raw["heading_rad"]), np.sin(raw["heading_rad"])
    x = raw["x_m"] + east * raw["along_m"] + north * raw["across_m"]
    y = raw["y_m"] + north * raw["along_m"] - east * raw["across_m"]
    return np.column_stack([x, y, -raw["depth_m"] - raw["down_m"]])
