"""Truths of the catalogue of methods: it has a family and a stage for whatever a table may name."""

import pytest

import toy_submaps
from pointnetkl.methods import estimated
from pointnetkl.methods.fitted import learned
from pointnetkl.registration.covariance import catalogue
from pointnetkl.registration.covariance.catalogue import Family, Stage


def test_every_method_that_needs_no_training_label_is_listed_under_its_stage():
    settings = estimated.Settings(seed=5, sampled_runs=[5, 300])
    methods = estimated.without_labels(settings, toy_submaps.LABEL, toy_submaps.REGISTRATION)
    names = [catalogue.CONSTANT, *(method.name for method in methods)]
    listed = [name for name, entry in catalogue.METHODS.items() if entry.stage is Stage.ESTIMATE]
    assert [*listed, catalogue.sampled(5), catalogue.sampled(300)] == names
    assert {catalogue.entry(name).stage for name in names} == {Stage.ESTIMATE}


def test_every_method_that_learns_numbers_is_listed_under_its_stage():
    listed = [name for name, entry in catalogue.METHODS.items() if entry.stage is Stage.FIT]
    assert listed == list(learned.LEARNERS)


@pytest.mark.parametrize(
    ("name", "family", "stage"),
    [
        ("mc_13", Family.SAMPLED, Stage.ESTIMATE),
        ("my_own_model", Family.NETWORKS, Stage.PREDICT),
        ("mccormick", Family.NETWORKS, Stage.PREDICT),
        ("network_overlap", Family.NETWORKS, Stage.CALIBRATE),
        ("censi_overlap", Family.CLOSED_FORMS, Stage.CALIBRATE),
    ],
)
def test_names_that_are_made_as_the_pipeline_runs_have_a_family_and_a_stage(name, family, stage):
    assert (catalogue.family(name), catalogue.entry(name).stage) == (family, stage)


def test_a_mean_of_training_labels_is_no_constant_of_the_test_survey():
    assert catalogue.family(catalogue.CONSTANT) is Family.RIVALS
    assert catalogue.family(catalogue.CONSTANT_TRAIN) is Family.LEARNED


def test_every_family_has_a_name_in_the_catalogue():
    names = [*catalogue.METHODS, catalogue.sampled(13), *catalogue.REFERENCES]
    assert {catalogue.family(name) for name in names} == set(Family)
