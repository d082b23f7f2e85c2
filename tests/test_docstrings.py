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
FUNCTIONS = [name for name in bayes_rs.__all__ if inspect.isfunction(getattr(bayes_rs, name))]
CLASSES = [name for name in bayes_rs.__all__ if inspect.isclass(getattr(bayes_rs, name))]


@pytest.mark.parametrize("name", FUNCTIONS + CLASSES)
def test_docstring_is_complete_and_true_to_the_signature(name):
    codes = CODES if name in FUNCTIONS else CODES - {"PR01"}  # errors and the abstract prior take no parameters
    errors = [text for code, text in validate(f"bayes_rs.{name}")["errors"] if code in codes]
    assert errors == []


def test_there_is_something_to_check():
    assert len(FUNCTIONS) > 20
    assert len(CLASSES) > 8
