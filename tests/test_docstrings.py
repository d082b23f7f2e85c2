"""Docstrings of everything public: complete, and in step with the signatures."""

import inspect

import pytest
from numpydoc.validate import validate

import bayes_rs

CODES = {
    "GL08",  # no docstring
    "SS03",  # summary without a full stop
    "PR01",  # a parameter is not documented
    "PR02",  # a documented parameter does not exist
    "PR03",  # parameters in another order than the signature's
    "RT01",  # no Returns section
    "YD01",  # no Yields section
}
PACKAGES = ["", *(name for name in bayes_rs.__all__ if inspect.ismodule(getattr(bayes_rs, name)))]
PLACES = {
    f"bayes_rs.{f'{subject}.' if subject else ''}{name}": getattr(package, name)
    for subject in PACKAGES
    for package in [getattr(bayes_rs, subject) if subject else bayes_rs]
    for name in package.__all__
}
"""Everything public by its place, on top and in the subjects."""
FUNCTIONS = [place for place, found in PLACES.items() if inspect.isfunction(found)]
CLASSES = [place for place, found in PLACES.items() if inspect.isclass(found)]


@pytest.mark.parametrize("place", FUNCTIONS + CLASSES)
def test_docstring_is_complete_and_true_to_the_signature(place):
    codes = CODES if place in FUNCTIONS else CODES - {"PR01"}  # errors and the abstract prior take no parameters
    errors = [text for code, text in validate(place)["errors"] if code in codes]
    assert errors == []


def test_there_is_something_to_check():
    assert len(FUNCTIONS) > 60
    assert len(CLASSES) > 30


@pytest.mark.parametrize("subject", PACKAGES)
def test_a_package_says_what_it_is(subject):
    assert inspect.getdoc(getattr(bayes_rs, subject) if subject else bayes_rs)
