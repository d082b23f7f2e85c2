"""The Reynolds stress tensor: packing, rotation, realizability."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from bayes_rs import STRESSES, InputError
from bayes_rs.geometry.scan import tilt_matrix, yaw_matrix
from bayes_rs.geometry.stress import (
    first_impossible,
    is_realizable,
    pack_stress,
    principal_variances,
    rotate_stress,
    unpack_stress,
)

STRESS = arrays(np.float64, 6, elements=st.floats(-5.0, 5.0))


def test_order_of_the_six_stresses_is_the_documented_one():
    assert STRESSES == ("uu", "vv", "ww", "uv", "uw", "vw")
    tensor = unpack_stress([11.0, 22.0, 33.0, 12.0, 13.0, 23.0])
    for name, value in zip(STRESSES, (11.0, 22.0, 33.0, 12.0, 13.0, 23.0), strict=True):
        row, column = ("uvw".index(letter) for letter in name)
        assert tensor[row, column] == tensor[column, row] == value


@given(STRESS)
def test_packing_undoes_unpacking(stress):
    np.testing.assert_array_equal(pack_stress(unpack_stress(stress)), stress)


class TestRotation:
    """Laws of a change of frame."""

    @given(STRESS, st.floats(-np.pi, np.pi), st.floats(-1.5, 1.5))
    def test_keeps_the_principal_variances(self, stress, yaw, tilt):
        rotation = tilt_matrix(tilt) @ yaw_matrix(yaw)
        # rounding of a few products of numbers up to 5
        np.testing.assert_allclose(
            principal_variances(rotate_stress(stress, rotation)), principal_variances(stress), atol=1e-13
        )

    @given(STRESS, st.floats(-np.pi, np.pi), st.floats(-1.5, 1.5))
    def test_of_beam_and_tensor_together_changes_no_variance(self, stress, yaw, tilt):
        rotation = tilt_matrix(tilt) @ yaw_matrix(yaw)
        beam = np.array([-0.6, 0.48, 0.64])
        before = beam @ unpack_stress(stress) @ beam
        turned = beam @ rotation
        after = turned @ unpack_stress(rotate_stress(stress, rotation)) @ turned
        assert after == pytest.approx(before, abs=1e-13)


class TestRealizability:
    def test_rank_one_tensors_are_on_the_edge_and_count_as_realizable(self):
        velocity = np.random.default_rng(1).normal(size=(1000, 3))
        assert is_realizable(pack_stress(velocity[:, :, None] * velocity[:, None, :])).all()

    def test_a_correlation_above_one_is_not(self):
        assert not is_realizable([1.0, 1.0, 1.0, 0.0, 1.01, 0.0])

    def test_a_negative_variance_is_not(self):
        assert not is_realizable([1.0, -0.01, 1.0, 0.0, 0.0, 0.0])

    def test_three_pairwise_possible_correlations_can_be_impossible_together(self):
        assert is_realizable([1.0, 1.0, 1.0, 0.9, 0.9, 0.9])
        assert not is_realizable([1.0, 1.0, 1.0, 0.9, 0.9, -0.9])


class TestImpossible:
    """What no wind has is found in tensors that were measured, whole or in part."""

    @given(STRESS)
    def test_a_whole_tensor_is_judged_by_its_smallest_principal_variance(self, stress):
        variances = principal_variances(stress)
        if abs(variances[0]) > 1e-6 * np.abs(variances).max():
            assert (first_impossible(stress[np.newaxis]) is None) == (variances[0] > 0.0)

    def test_the_first_row_and_its_fault_are_told(self):
        good, nan = [1.0, 1.0, 1.0, 0.9, 0.9, 0.7], np.nan
        assert (
            first_impossible([good, [1.0, nan, nan, nan, nan, nan], [nan] * 6, [1.0, nan, 1.0, 7.0, 0.9, nan]]) is None
        )
        assert first_impossible([good, [1.0, 0.0, 1.0, 0.0, 0.0, 0.0]]) == (
            1,
            "has vv 0 m² s⁻²: a variance is above zero",
        )
        row, words = first_impossible([good, good, [1.0, nan, 4.0, nan, -2.0, nan]])
        assert (row, words[:51]) == (2, "has uw -2 m² s⁻², beyond the root of uu times ww, 2")
        row, words = first_impossible([good, [1.0, 1.0, 1.0, 0.9, 0.9, -0.9]])
        assert (row, words[:42]) == (1, "has the smallest principal variance -0.8 m")

    @given(arrays(np.float64, 6, elements=st.floats(0.1, 5.0)), st.integers(3, 5))
    def test_a_tensor_without_a_covariance_that_is_taken_can_be_completed(self, stress, missing):
        """The covariance that the other two make by themselves completes it."""
        stress[missing] = np.nan
        if first_impossible(stress[np.newaxis]) is None:
            middle = {3: 2, 4: 1, 5: 0}[missing]  # uv by w, uw by v, vw by u
            others = [column for column in (3, 4, 5) if column != missing]
            stress[missing] = np.prod(stress[others]) / stress[middle]
            assert principal_variances(stress)[0] > -1e-9


def test_bad_shapes_are_refused():
    with pytest.raises(InputError, match=r"Invalid stress of shape \(5,\): the last dimension must hold uu, vv"):
        unpack_stress(np.ones(5))
    with pytest.raises(InputError, match=r"Invalid tensor of shape \(2, 3\): the last two dimensions must be 3 and 3"):
        pack_stress(np.ones((2, 3)))
    with pytest.raises(InputError, match="must be symmetric"):
        pack_stress([[1.0, 0.5, 0.0], [0.4, 1.0, 0.0], [0.0, 0.0, 1.0]])
