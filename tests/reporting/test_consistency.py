"""The figure of consistency maps: a panel a trajectory, one scale a survey."""

import numpy as np
from matplotlib.figure import Figure

from pointnetkl.reporting.drawing import plots
from pointnetkl.reporting.slam import consistency
from pointnetkl.slam.consistency.consistency_map import Rasters

RNG = np.random.default_rng(0)
EXTENT = (1000.0, 1300.0, 50.0, 200.0)


def image(scale: float) -> np.ndarray:
    errors = RNG.gamma(3.0, scale, (10, 20)).astype(np.float32)
    errors[:, :4] = np.nan
    return errors


def drawn(errors: dict[str, np.ndarray]) -> Figure:
    return consistency.consistency({"borno_8": Rasters(errors, EXTENT)})


def test_every_trajectory_is_drawn_on_one_scale_that_leaves_out_the_worst_cells():
    errors = {"gt": image(1.0), "corrupted": image(3.0)}
    images = [drawing for axes in drawn(errors).axes for drawing in axes.images]
    cells = np.concatenate([raster[np.isfinite(raster)] for raster in errors.values()])
    assert [drawing.get_clim() for drawing in images] == [(0.0, np.percentile(cells, 95))] * 2
    assert [drawing.get_extent() for drawing in images] == [list(EXTENT)] * 2


def test_a_panel_says_the_root_mean_square_of_its_cells():
    errors = {"gt": image(1.0)}
    texts = [text.get_text() for text in drawn(errors).texts]
    assert f"GT: {np.sqrt(np.nanmean(errors['gt'].astype(float) ** 2)):.3g} m" in texts


def test_a_map_without_overlap_can_be_drawn():
    empty = drawn({"gt": np.full((1, 1), np.nan, np.float32)})
    assert "GT: no overlap" in [text.get_text() for text in empty.texts]
    assert plots.png(empty).startswith(b"\x89PNG")
