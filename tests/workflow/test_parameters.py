"""Parameters are what the file says, exactly, or one sentence says what is wrong with them."""

import dataclasses
from dataclasses import dataclass, field
from pathlib import Path

import pytest
import yaml
from hypothesis import HealthCheck, given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st

from pointnetkl import segmentation
from pointnetkl.surveys import voxel
from pointnetkl.workflow import parameters, study
from pointnetkl.workflow.parameters import SettingsError


@dataclass(frozen=True)
class Inner:
    seed: int
    rate: float


@dataclass(frozen=True)
class Outer:
    name: str
    on: bool
    steps: list[int]
    inner: dict[str, Inner]
    limit: float | None = None
    extra: list[float] = field(default_factory=list)


GOOD = {"name": "a", "on": True, "steps": [1, 2], "inner": {"x": {"seed": 1, "rate": 2}}}

few = hypothesis_settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


def read(folder: Path, content: object, section: str = "s", kind: type = Outer) -> object:
    path = folder / "params.yaml"
    path.write_text(yaml.safe_dump({"s": content}))
    return parameters.read(path, section, kind)


def complaint(folder: Path, content: object, section: str = "s", kind: type = Outer) -> str:
    with pytest.raises(SettingsError) as caught:
        read(folder, content, section, kind)
    return str(caught.value).replace(str(folder) + "/", "")


def test_a_section_becomes_the_dataclass_with_its_defaults(tmp_path: Path):
    settings = read(tmp_path, GOOD)
    assert settings == Outer("a", True, [1, 2], {"x": Inner(1, 2.0)}, None, [])
    assert isinstance(settings.inner["x"].rate, float)


def test_a_dotted_name_reaches_inside(tmp_path: Path):
    assert read(tmp_path, GOOD, "s.inner.x", Inner) == Inner(1, 2.0)


@few
@given(st.integers(-(2**40), 2**40), st.floats(allow_nan=False, allow_infinity=False))
def test_numbers_come_back_as_they_were_written(tmp_path: Path, seed: int, rate: float):
    assert read(tmp_path, {"seed": seed, "rate": rate}, kind=Inner) == Inner(seed, rate)


@few
@given(
    st.sampled_from(["name", "on", "steps", "inner", "limit"]),
    st.one_of(st.dates(), st.just({"deep": {"er": 1}}), st.just([["x"]]), st.just([None]), st.binary(max_size=3)),
)
def test_a_value_of_any_wrong_kind_is_one_sentence(tmp_path: Path, name: str, value: object):
    message = complaint(tmp_path, GOOD | {name: value})
    assert message.startswith(f"params.yaml: s.{name}")
    assert "\n" not in message


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"name": 3}, "params.yaml: s.name is 3, must be text"),
        ({"on": 1}, "params.yaml: s.on is 1, must be true or false"),
        ({"steps": [1, 2.5]}, "params.yaml: s.steps[1] is 2.5, must be a whole number"),
        ({"steps": [True]}, "params.yaml: s.steps[0] is True, must be a whole number"),
        (
            {"limit": "1e-4"},
            "params.yaml: s.limit is '1e-4', must be a finite number; write it with a point, as 1.0e-4",
        ),
        ({"limit": float("nan")}, "params.yaml: s.limit is nan, must be a finite number"),
        ({"limit": float("inf")}, "params.yaml: s.limit is inf, must be a finite number"),
        ({"inner": {7: {"seed": 1, "rate": 2}}}, "params.yaml: s.inner is 7, must be text"),
        ({"inner": {"x": 5}}, "params.yaml: s.inner.x must be a group of settings, not 5"),
        ({"inner": {"x": {"seed": 1}}}, "params.yaml: s.inner.x.rate is missing"),
        ({"nmae": "b"}, "params.yaml: s.nmae is unknown; it has name, on, steps, inner, limit, extra"),
        ({5: "b"}, "params.yaml: s.5 is unknown; it has name, on, steps, inner, limit, extra"),
    ],
)
def test_what_is_wrong_is_named(tmp_path: Path, change: dict[object, object], message: str):
    assert complaint(tmp_path, GOOD | change) == message


def test_a_missing_section_lists_what_there_is(tmp_path: Path):
    expected = "params.yaml: there is no s.inner.y; at 'y' the file has x"
    assert complaint(tmp_path, GOOD, "s.inner.y") == expected
    assert complaint(tmp_path, GOOD, "t") == "params.yaml: there is no t; at 't' the file has s"
    assert complaint(tmp_path, None) == "params.yaml: s must be a group of settings, not None"


def test_a_file_that_is_no_parameter_file_is_one_sentence(tmp_path: Path):
    path = tmp_path / "params.yaml"
    with pytest.raises(SettingsError, match="cannot be read"):
        parameters.read(path, "s", Inner)
    for content, message in [
        (b"a: [1", "is not valid YAML"),
        (b"\xff\xfe\x00", "is not"),
        (b"", "the file has nothing"),
    ]:
        path.write_bytes(content)
        with pytest.raises(SettingsError, match=message):
            parameters.read(path, "s", Inner)


@pytest.mark.parametrize(
    ("kind", "content", "message"),
    [
        (
            segmentation.Settings,
            {"seed": 0, "max_gap_m": -3},
            "params.yaml: s.max_gap_m is -3.0, must be above zero",
        ),
        (segmentation.Settings, {"seed": -1, "max_gap_m": 3}, "params.yaml: s.seed is -1, must be 0 or above"),
        (voxel.Settings, {"voxel": 0}, "params.yaml: s.voxel is 0, must be between 0.0001 and 1"),
        (
            study.StudySurvey,
            {"group": "test", "raw": "a", "truth": "b", "submap_length_m": 5, "point_spacing_m": 3, "label_runs": 1},
            "params.yaml: s.submap_length_m is 5, must be at least twice point_spacing_m",
        ),
    ],
)
def test_a_value_that_a_stage_cannot_use_is_refused_by_name(tmp_path: Path, kind: type, content: object, message: str):
    assert complaint(tmp_path, content, kind=kind).startswith(message)


def test_the_study_of_the_project_holds_every_survey_once():
    path = Path(__file__).parents[2] / "params.yaml"
    complete = study.read(path)
    assert not set(complete.train) & set(complete.test)
    assert complete.surveys == complete.train | complete.test
    assert all(study.survey(path, name) == line for name, line in complete.surveys.items())


@pytest.mark.parametrize("models", [[], ["network"], ["pointnetkl"], ["pointnetkl", "network", "network"]])
def test_a_study_without_the_models_that_predict_is_refused(tmp_path: Path, models: list[str]):
    content = {"train": {}, "test": {}, "surveys": {}, "models": models}
    message = f"params.yaml: s.models is {models}, must name pointnetkl and network, and each model once"
    assert complaint(tmp_path, content, kind=study.Study) == message


def test_metadata_holds_what_was_read():
    assert parameters.as_metadata(Inner(1, 2.0)) == dataclasses.asdict(Inner(1, 2.0))


def test_a_study_that_tests_on_what_it_trained_on_is_refused(tmp_path: Path):
    line = "{group: %s, raw: a, truth: data/none, submap_length_m: 100, point_spacing_m: 4.0, label_runs: 9}"
    path = tmp_path / "params.yaml"
    for train, test in (("x", "x"), ("x", "y")):  # the same name; other names for the same raw files
        lines = f"  train: {{{train}: {line % 'train'}}}\n  test: {{{test}: {line % 'test'}}}"
        path.write_text(f"study:\n{lines}\n  surveys: {{}}\n")
        with pytest.raises(parameters.SettingsError, match=r"which train has|of a training survey"):
            study.read(path)


def test_a_survey_whose_line_names_the_other_group_is_refused(tmp_path: Path):
    line = "{group: train, raw: a, truth: data/none, submap_length_m: 100, point_spacing_m: 4.0, label_runs: 9}"
    path = tmp_path / "params.yaml"
    path.write_text(f"study:\n  train: {{}}\n  test: {{x: {line}}}\n  surveys: {{}}\n")
    with pytest.raises(parameters.SettingsError, match=r"test\.x\.group is 'train', must be test"):
        study.read(path)


def test_a_study_without_a_training_survey_cannot_train(tmp_path: Path):
    path = tmp_path / "params.yaml"
    path.write_text("study: {train: {}, test: {}, surveys: {}}\n")
    with pytest.raises(parameters.SettingsError, match=r"study\.train names no survey"):
        study.training_surveys(path)


def test_a_survey_is_looked_for_in_the_list_that_its_group_names(tmp_path: Path):
    line = "{group: train, raw: a, truth: data/none, submap_length_m: 100, point_spacing_m: 4.0, label_runs: 9}"
    path = tmp_path / "params.yaml"
    path.write_text(f"study:\n  train: {{}}\n  test: {{x: {line}}}\n  surveys: {{x: {line}}}\n")
    with pytest.raises(parameters.SettingsError, match=r"x\.group is .train., but study\.train has no x"):
        study.survey(path, "x")
