"""The counter-based noise: Philox's published answers, normal numbers, and the same draws in every batch."""

import numpy as np
import pytest
from scipy import stats

from pointnetkl.registration import gicp
from pointnetkl.registration.gicp import noise


@pytest.mark.parametrize(
    ("counter", "key", "words"),
    [
        # the known answers published with Salmon 2011
        ((0, 0, 0, 0), (0, 0), (0x6627E8D5, 0xE169C58D, 0xBC57AC4C, 0x9B00DBD8)),
        ((2**32 - 1,) * 4, (2**32 - 1,) * 2, (0x408F276D, 0x41C83B0E, 0xA20BC7C6, 0x6D5451FD)),
        (
            (0x243F6A88, 0x85A308D3, 0x13198A2E, 0x03707344),
            (0xA4093822, 0x299F31D0),
            (0xD16CFE09, 0x94FDCCEB, 0x5001E420, 0x24126EA1),
        ),
    ],
)
def test_philox_gives_the_published_answers(
    counter: tuple[int, ...], key: tuple[int, ...], words: tuple[int, ...]
) -> None:
    assert noise.philox(*map(np.uint32, counter + key)) == words


def test_noise_is_normal_in_every_coordinate_and_independent_between_them() -> None:
    drawn = gicp.Noise(sigma_m=2.0, key=99).draw(100, 2000) / 2.0
    for axis in range(3):
        assert stats.kstest(drawn[..., axis].ravel(), "norm").pvalue > 1e-3
    flat = drawn.reshape(-1, 3).astype(np.float64)
    assert np.allclose(np.cov(flat.T), np.eye(3), atol=5 * np.sqrt(2 / len(flat)))
    # squares too: coordinates that share a radius would be uncorrelated and yet dependent
    assert np.allclose(np.corrcoef((flat**2).T), np.eye(3), atol=5 / np.sqrt(len(flat)))
    assert np.isclose((flat**4).mean(), 3, atol=5 * np.sqrt(96 / flat.size))


def test_neighbouring_points_runs_and_keys_have_unrelated_noise() -> None:
    drawn = gicp.Noise(1.0, 5).draw(200, 1000).astype(np.float64)
    other = gicp.Noise(1.0, 6).draw(200, 1000)
    for a, b in ((drawn[1:], drawn[:-1]), (drawn[:, 1:], drawn[:, :-1]), (drawn, other)):
        assert abs(np.mean(a * b)) < 5 / np.sqrt(a.size)


def test_a_run_has_the_same_noise_in_every_batch_and_for_every_number_of_points() -> None:
    whole = gicp.Noise(0.3, 2**63 - 1).draw(10, 100)
    assert np.array_equal(gicp.Noise(0.3, 2**63 - 1, first=7).draw(3, 50), whole[7:, :50])


def test_runs_beyond_32_bits_have_noise_of_their_own() -> None:
    assert not np.array_equal(gicp.Noise(1.0, 5, 2**32).draw(1, 10), gicp.Noise(1.0, 5).draw(1, 10))


def test_noise_of_sigma_zero_is_zero() -> None:
    assert not gicp.Noise(0.0, 1).draw(2, 10).any()


def test_extreme_words_give_finite_numbers() -> None:
    for word in (0, 1, 2**31 - 1, 2**31, 2**32 - 1):
        assert np.isfinite(noise._radius(np.uint32(word)))
        x, y = noise._direction(np.uint32(word))
        assert np.isclose(np.hypot(x, y), 1, atol=1e-5)
