"""MAP registration: against the plain reference, and what must hold of a most probable place."""

import dataclasses
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import pairs
from pairs import SETTINGS, SPACING_M, prior
from pointnetkl.labels import shards
from pointnetkl.registration import gicp, pair
from pointnetkl.registration.pair import compilation, reference
from pointnetkl.slam.closing import search
from pointnetkl.surveys.se2 import SE2
from pointnetkl.workflow import parameters

DOFS = ("xy", "xyyaw")
KINDS = ("flat", "gentle", "mild", "rugged", "ridge")
START = SE2(np.array([1.5, -2.0]), 0.0)


def register(source: gicp.Cloud | gicp.Part, target: gicp.Cloud, dof: str, start: SE2 = START) -> pair.Estimate:
    return pair.register(source, target, prior(dof), SPACING_M, SETTINGS[dof], start)


@pytest.mark.parametrize("dof", DOFS)
@pytest.mark.parametrize("kind", KINDS)
def test_the_place_is_that_of_the_reference(kind: str, dof: str) -> None:
    # a point that is as near to two others may choose the other one in float32, and the rest of the search is another:
    # one search in six, and on flat ground by decimetres
    differences = [difference_to_reference(kind, number, dof) for number in range(5)]
    assert np.median(differences) < 1e-4


@pytest.mark.parametrize("dof", DOFS)
def test_a_source_far_from_the_target_s_centre_turns_about_its_own(dof: str) -> None:
    def east(source: gicp.Cloud) -> gicp.Part:
        return gicp.part(source, source.points[:, 0] > 20, pairs.GICP)

    differences = [difference_to_reference("rugged", number, dof, east) for number in range(5)]
    assert np.median(differences) < 1e-4


def difference_to_reference(
    kind: str, number: int, dof: str, part: Callable[[gicp.Cloud], gicp.Part | gicp.Cloud] = lambda source: source
) -> float:
    """Return by how much the kernel and the reference differ in x, y in metres or yaw in radians."""
    source, target = pairs.clouds(kind, number)
    source = part(source)
    start = dataclasses.replace(START, yaw=0.02 if dof == "xyyaw" else 0.0)
    moving, still = pairs.plain(source, target)
    moved = moving._replace(points=start.act(moving.points), normals=moving.normals @ start.to_matrix()[:3, :3].T)
    expected = reference.register(moved, still, prior(dof), SPACING_M, SETTINGS[dof]) @ start
    found = register(source, target, dof, start).T_target_source
    return float(np.abs(found.to_vector() - expected.to_vector()).max())


def test_the_default_method_is_gicp_and_its_answer_has_the_same_bytes() -> None:
    source, target = pairs.clouds("mild")
    ours = pair.register(source, target, prior("xy"), SPACING_M, pairs.GICP, START)
    plain = gicp.register(source, target, pairs.GICP, START)
    assert ours.T_target_source.to_vector().tobytes() == plain.T_target_source.to_vector().tobytes()
    assert (ours.converged, ours.iterations) == (plain.converged, plain.iterations)


def test_the_parameters_of_registration_are_those_of_a_pair_and_gicp_s_own_are_unchanged() -> None:
    params = Path(__file__).parents[2] / "params.yaml"
    settings = parameters.read(params, "registration", pair.Settings)
    assert settings.method == "gicp"
    assert settings.as_gicp == parameters.read(params, "registration", gicp.Settings)


def test_the_parameters_of_closing_are_the_defaults_that_benchmarks_take() -> None:
    settings = parameters.read(Path(__file__).parents[2] / "params.yaml", "close.closing.search", search.Settings)
    assert settings.numbers == pair.covariance.Settings()
    assert settings.gates == pair.factor.Settings()


def test_kernels_are_compiled_again_when_any_file_of_theirs_or_of_gicp_s_changes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert {folder.name for folder in compilation._FOLDERS} == {"pair", "gicp"}
    monkeypatch.setattr(compilation, "_FOLDERS", (tmp_path,))
    (tmp_path / "a.py").write_text("one")
    before = compilation._sources()
    (tmp_path / "a.py").write_text("two")
    assert compilation._sources() != before


def test_no_label_hangs_on_the_code_of_pairs() -> None:
    library = Path(pair.__file__).parents[2]
    decide = {path for pattern in shards.SOURCES for path in library.glob(pattern)}
    assert not [path for path in decide if Path(pair.__file__).parent in path.parents]


@pytest.mark.parametrize("dof", DOFS)
def test_the_answer_is_the_same_wherever_the_map_lies(dof: str) -> None:
    for kind in KINDS:
        here = register(*pairs.clouds(kind), dof)
        offset = np.array([650_000.0, 6_400_000.0, -350.0])
        there = register(*(gicp.prepare(pairs.points(kind, k) + offset, pairs.GICP) for k in (0, 1)), dof)
        assert there.T_target_source.to_vector() == pytest.approx(here.T_target_source.to_vector(), abs=1e-3)


@pytest.mark.parametrize("dof", DOFS)
@pytest.mark.parametrize("angle", [0.7, np.pi / 2])
@pytest.mark.parametrize("kind", ["mild", "rugged", "ridge"])
def test_the_answer_turns_with_the_clouds(kind: str, angle: float, dof: str) -> None:
    R, differences = pairs.rotation(angle), []
    for number in range(5):
        straight = register(*pairs.clouds(kind, number), dof).T_target_source.to_vector()
        clouds = [gicp.prepare(pairs.points(kind, 2 * number + k) @ R.T, pairs.GICP) for k in (0, 1)]
        turned = register(*clouds, dof, SE2(R[:2, :2] @ START.translation, 0.0)).T_target_source.to_vector()
        differences.append(np.abs(turned - R @ straight).max())
    assert np.median(differences) < 1e-3  # the rest are searches with a tie, as above


@pytest.mark.parametrize("dof", DOFS)
def test_on_flat_ground_the_answer_is_the_start(dof: str) -> None:
    start = dataclasses.replace(START, yaw=0.02 if dof == "xyyaw" else 0.0)
    end = register(*pairs.clouds("flat", noise_m=0.0), dof, start)
    assert end.T_target_source.to_vector() == pytest.approx(start.to_vector(), abs=1e-6)
    assert end.converged


@pytest.mark.parametrize("dof", DOFS)
def test_on_a_ridge_it_finds_the_place_across_it(dof: str) -> None:
    # along it, what noise makes of the normals moves the search as on flat ground: test_pair_factor has the cure
    for number in range(4):
        _, y, yaw = register(*pairs.clouds("ridge", number), dof).T_target_source.to_vector()
        assert abs(y) < 0.1
        assert abs(yaw) < 5e-3


@pytest.mark.parametrize("dof", DOFS)
def test_on_rugged_ground_it_agrees_with_gicp(dof: str) -> None:
    by_gicp = dataclasses.replace(SETTINGS[dof], method="gicp")
    for number in range(4):
        source, target = pairs.clouds("rugged", number)
        ends = [
            pair.register(source, target, prior(dof), SPACING_M, settings, START).T_target_source.to_vector()
            for settings in (SETTINGS[dof], by_gicp)
        ]
        assert ends[0] == pytest.approx(ends[1], abs=0.05)
        assert ends[0] == pytest.approx(np.zeros(3), abs=0.2)  # both passes lie where they truly do


def test_a_tighter_prior_keeps_it_nearer_to_the_start_where_ground_is_weak() -> None:
    source, target = pairs.clouds("gentle")
    moved = [
        pair.register(source, target, prior("xy", sigma), SPACING_M, SETTINGS["xy"], START).T_target_source.translation
        for sigma in (0.01, 0.3, 3.0)
    ]
    distances = [float(np.hypot(*(each - START.translation))) for each in moved]
    assert distances[0] < 0.01
    assert distances == sorted(distances)


def test_a_step_below_a_small_share_of_a_sigma_ends_the_search() -> None:
    clouds = pairs.clouds("gentle")
    steps, places = [], []
    for tolerance in (0.0, 0.03, 0.3):
        settings = dataclasses.replace(SETTINGS["xy"], tolerance_sigmas=tolerance, map_steps=50)
        end = pair.register(*clouds, prior("xy"), SPACING_M, settings, START)
        steps.append(end.iterations)
        places.append(end.T_target_source.translation)
    assert steps == sorted(steps, reverse=True)
    assert steps[0] > steps[2]
    assert places[1] == pytest.approx(places[0], abs=0.05)


def test_a_cloud_without_matches_stays_where_it_is_and_tells_nothing() -> None:
    source, target = pairs.clouds("rugged")
    far = SE2(np.array([1000.0, 0.0]), 0.0)
    end = register(source, target, "xy", far)
    assert end.T_target_source.translation == pytest.approx(far.translation)
    assert not end.converged
    assert end.matched_share == 0
    assert not pair.covariance.information(end.forces, pairs.NUMBERS).any()


def test_a_part_of_a_cloud_answers_as_the_cloud_of_its_points() -> None:
    source, target = pairs.clouds("rugged")
    keep = source.points[:, 0] > 0
    part = gicp.part(source, keep, pairs.GICP)
    whole = gicp.prepare(source.points[keep], pairs.GICP)
    ends = [register(each, target, "xy").T_target_source.translation for each in (part, whole)]
    assert ends[0] == pytest.approx(ends[1], abs=1e-3)


@pytest.mark.parametrize("bad", [np.eye(3), np.zeros((2, 2)), np.array([[1.0, 2.0], [2.0, 1.0]])])
def test_a_prior_that_is_no_covariance_is_refused(bad: np.ndarray) -> None:
    with pytest.raises(pair.PairError, match="must be a covariance of 2 dimensions"):
        pair.register(*pairs.clouds("flat"), bad, SPACING_M, SETTINGS["xy"])


def test_a_start_with_a_yaw_needs_the_dof_that_finds_one() -> None:
    with pytest.raises(pair.PairError, match="xyyaw"):
        register(*pairs.clouds("flat"), "xy", SE2(np.zeros(2), 0.1))


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("method", "icp"),
        ("map_steps", 0),
        ("residuals_as_one", 0.0),
        ("longest_step_spacings", -1.0),
        ("tolerance_sigmas", -1.0),
    ],
)
def test_settings_out_of_range_are_refused(name: str, value: object) -> None:
    with pytest.raises(ValueError, match=name):
        dataclasses.replace(pairs.GICP, **{name: value})
