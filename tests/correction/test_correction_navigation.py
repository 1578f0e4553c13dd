"""What a survey's positions are: as it is said, else as the files beside it and its depth suggest."""

from pathlib import Path

import numpy as np
import pytest

import raw_survey
from pointnetkl.correction.preparation import navigation
from pointnetkl.correction.preparation.inputs import Inputs
from pointnetkl.correction.preparation.navigation import Kind
from pointnetkl.correction.settings import NAVIGATION, Settings
from pointnetkl.readers.smrmsg import SmrmsgError
from pointnetkl.slam.closing import drift
from pointnetkl.surveys.survey import SUBMAPS, SWATHS
from raw_survey import Plan, Raw

METADATA = {"kind": SWATHS, "crs": raw_survey.CRS}


@pytest.fixture
def raw(tmp_path: Path) -> Raw:
    return raw_survey.write(tmp_path / "raw", Plan(lines=2, line_m=20.0, beams=9, on_earth=True))


def kind(raw: Raw, settings: Settings | None = None, depth_m: float = 20.0, **metadata: str) -> Kind:
    pings = raw_survey.pings(lines=2).assign(z_m=-depth_m)
    return navigation.kind(Inputs([raw.folder]), settings or Settings(), pings, METADATA | metadata)


def test_a_deep_vehicle_reckons(raw: Raw):
    found = kind(raw)
    assert (found.name, found.rates) == ("dead-reckoning", drift.PRESETS["gyrocompass"])


def test_a_sonar_near_the_surface_is_a_ship_s_which_has_a_satellite_receiver(raw: Raw):
    found = kind(raw, depth_m=4.5)
    assert (found.name, found.rates) == ("gnss", drift.PRESETS["gnss"])
    assert "4.5 m below the surface" in found.reason


@pytest.mark.parametrize("metadata", [{"crs": "local"}, {"kind": SUBMAPS}])
def test_what_has_no_place_or_no_surface_says_nothing_of_satellites(raw: Raw, metadata: dict):
    assert kind(raw, depth_m=4.5, **metadata).name == "dead-reckoning"


def test_an_sbet_beside_it_is_of_satellites(raw: Raw):
    raw_survey.sbet(raw.folder / "track.out", raw)
    found = kind(raw)
    assert (found.name, found.rates) == ("gnss", drift.PRESETS["gnss"])
    assert "SBET" in found.reason


def test_an_smrmsg_beside_an_sbet_says_how_sure_it_is(raw: Raw):
    raw_survey.sbet(raw.folder / "track.sbet", raw)
    raw_survey.smrmsg(raw.folder / "smrmsg_track.out", 0.06, 3.0)
    found = kind(raw)
    assert found.name == "gnss"
    assert found.rates.position_walk_m == pytest.approx(0.06)
    assert found.rates.yaw_noise_rad == pytest.approx(np.deg2rad(0.05))
    assert "smrmsg_track.out states 0.06 m" in found.reason


def test_files_are_found_in_folders_below(raw: Raw):
    (raw.folder / "nav").mkdir()
    raw_survey.sbet(raw.folder / "nav" / "track.sbet", raw)
    raw_survey.smrmsg(raw.folder / "nav" / "smrmsg_track.out", 0.06, 3.0)
    assert kind(raw).rates.position_walk_m == pytest.approx(0.06)


def test_an_accuracy_that_no_receiver_has_is_not_believed(raw: Raw):
    raw_survey.sbet(raw.folder / "track.sbet", raw)
    raw_survey.smrmsg(raw.folder / "smrmsg_track.out", 1e-5, 1e-4)
    found = kind(raw)
    assert found.rates.position_walk_m == pytest.approx(0.02)
    assert found.rates.yaw_noise_rad == drift.PRESETS["gnss"].yaw_noise_rad


@pytest.mark.parametrize("name", NAVIGATION)
def test_what_is_said_comes_before_what_stands_beside(raw: Raw, name: str):
    raw_survey.sbet(raw.folder / "track.sbet", raw)
    found = kind(raw, Settings(navigation=name), depth_m=1.0)
    assert (found.name, found.rates) == (name, drift.PRESETS[NAVIGATION[name]])


@pytest.mark.parametrize("name", ["dead-reckoning", "usbl"])
def test_an_accuracy_of_satellites_is_not_that_of_other_navigation(raw: Raw, name: str):
    raw_survey.smrmsg(raw.folder / "smrmsg_track.out", 0.06, 3.0)
    assert kind(raw, Settings(navigation=name)).rates == drift.PRESETS[NAVIGATION[name]]


def test_rates_that_are_asked_for_come_before_those_of_a_file(raw: Raw):
    raw_survey.sbet(raw.folder / "track.sbet", raw)
    raw_survey.smrmsg(raw.folder / "smrmsg_track.out", 0.06, 3.0)
    assert kind(raw, Settings(drift="position_walk_m=2")).rates.position_walk_m == 2.0


def test_a_damaged_accuracy_is_one_sentence(raw: Raw):
    raw_survey.sbet(raw.folder / "track.sbet", raw)
    (raw.folder / "smrmsg_track.out").write_bytes(b"\xff" * 8000)
    with pytest.raises(SmrmsgError, match="is it SMRMSG"):
        kind(raw)


def test_rates_that_do_not_exist_are_one_sentence(raw: Raw):
    with pytest.raises(drift.DriftError, match="drift is 'hugin', must be one of"):
        kind(raw, Settings(drift="hugin"))


@pytest.mark.parametrize("name", ["._track.sbet", ".old/track.sbet"])
def test_hidden_files_say_nothing_as_readers_pass_them_over(raw: Raw, name: str):
    (raw.folder / name).parent.mkdir(exist_ok=True)
    raw_survey.sbet(raw.folder / name, raw)
    assert kind(raw).name == "dead-reckoning"
