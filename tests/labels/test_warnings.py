"""The label stage says how sure labels are, and warns of labels that mean nothing."""

import numpy as np
import pandas as pd

from pointnetkl.labels import warnings

K = 101
LABELS = pd.DataFrame({"runs": range(100, 100 + K), "relative_error": np.linspace(0, 1, K)}).assign(
    q_xx_m2=0.75, q_yy_m2=0.25, q_xy_m2=0.0, converged_share=0.9, main_basin_share=0.8, spacing_m=2.0
)


def printed(target: float | None = None, **columns: object) -> str:
    return "\n".join(warnings.lines("toy", LABELS.assign(**{"self_matching": False, **columns}), 3.0, target))


def test_eigenvalues_and_registrations_are_summarised_over_submaps():
    text = printed()
    assert "  smaller, toy                       0.25      0.25" in text
    assert "registrations a label 150 (100 to 200), converged 0.9, in the main basin 0.8" in text
    assert "relative standard error 0.5 (in 95 % of the submaps below 0.95)" in text
    assert "WARNING" not in text


def test_a_target_is_told_with_the_number_of_submaps_that_meet_it():
    assert "target of a relative standard error of 0.2 met in 21 of 101 submaps" in printed(0.2)


def test_self_matching_and_lost_registrations_are_warned_of():
    assert "WARNING: toy is self-matching in 101 of 101 submaps: spacing 2.0 m" in printed(self_matching=True)
    assert "WARNING: toy has 101 of 101 submaps on which under half" in printed(converged_share=0.4)
