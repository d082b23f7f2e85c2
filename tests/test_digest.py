"""The fingerprint: equal for what is equal, different for what is not."""

from dataclasses import dataclass

import numpy as np
import pytest
from scenes import plain_noise

from bayes_rs import Nuisances, load_scan
from bayes_rs.fits.digest import digest
from bayes_rs.noise.file import load_noise
from bayes_rs.priors.registry import make_prior


@dataclass(frozen=True)
class Pair:
    first: object
    second: object


class Plain:
    def __init__(self, value):
        self.value = value


class TestEqual:
    @pytest.mark.parametrize(
        ("one", "other"),
        [
            (1, 1.0),
            (0.9, np.float64(0.9)),
            (3, np.int64(3)),
            (True, np.True_),
            ((1, 2), [1, 2]),
            ({"a": 1, "b": 2}, {"b": 2, "a": 1}),
            (np.arange(6.0)[::2], np.array([0.0, 2.0, 4.0])),
            (np.array([["a", None]], dtype=object), np.array([["a", None]], dtype=object)),
            (Pair(1, np.ones(2)), Pair(1, np.ones(2))),
            (Plain(2), Plain(2)),
            (make_prior("weak"), make_prior("weak")),
            (np.datetime64("2020-01-01", "ns"), np.datetime64("2020-01-01", "ns")),
        ],
    )
    def test_what_is_equal_has_one_fingerprint(self, one, other):
        assert digest(one) == digest(other)

    def test_noise_that_was_saved_and_read_is_the_same(self, tmp_path):
        noise = plain_noise(load_scan("6-beam"))
        noise.save(tmp_path / "noise.nc")
        assert digest(load_noise(tmp_path / "noise.nc")) == digest(noise)


class TestDifferent:
    @pytest.mark.parametrize(
        ("one", "other"),
        [
            (1.0, np.nextafter(1.0, 2.0)),
            ("1", 1),
            (True, 1),
            (None, "None"),
            (b"a", "a"),
            (2**53, 2**53 + 1),
            (np.inf, 1.0),
            (np.zeros(4), np.zeros((2, 2))),
            (np.zeros(4), np.zeros(4, dtype=np.float32)),
            (np.array([0.0, np.nan]), np.array([0.0, 1.0])),
            (([1], 2), ([1, 2],)),
            (([], [1]), ([[1]], [])),
            (("ab", "c"), ("a", "bc")),
            ({"a": "b"}, {"ab": ""}),
            ({1: 0}, {"1": 0}),
            (np.array(["a;", "b"], dtype=object), np.array(["a", ";b"], dtype=object)),
            (Pair(1, 2), Pair(2, 1)),
            (Plain(1), Plain(2)),
            (make_prior("weak"), make_prior("flat")),
            (make_prior("weak"), make_prior("weak:log_sd_vv=1.3")),
            (Nuisances(), Nuisances(yaw_sd_deg=1.0)),
        ],
    )
    def test_what_differs_has_two(self, one, other):
        assert digest(one) != digest(other)

    def test_every_number_of_the_noise_counts(self):
        noise = plain_noise(load_scan("6-beam"))
        other = plain_noise(load_scan("6-beam"), relative_variance=0.06 * (1.0 + 1e-12))
        assert digest(noise) != digest(other)

    def test_several_things_are_not_one(self):
        assert digest(1, 2) != digest([1, 2])
        assert digest({}, [1, 2]) != digest({1: 2})
        assert digest() != digest(None)


class TestRefusal:
    @pytest.mark.parametrize("thing", [len, {1, 2}, lambda value: value, object()])
    def test_what_has_no_lasting_contents_is_refused(self, thing):
        # a set has no order, and a function's address is another one in the next run
        with pytest.raises(TypeError, match=r"No fingerprint of .*: it must be made of arrays, numbers"):
            digest([thing])
