"""The plan of a scene: decisions that follow from the scene, with their bounds."""

import pytest

from bayes_rs import InputError, plan


def decisions(name, **options):
    made = plan(name, wind_speed=10.0, **options)
    return {step.what: step for step in made.steps}, made


def test_every_step_has_a_reason_and_a_bound():
    steps, made = decisions("6-beam")
    assert len(steps) == len(made.steps) == 8
    for step in made.steps:
        assert step.decision
        assert step.why
        assert step.bound


def test_surplus_beams_are_reduced_and_unseen_directions_named():
    steps, _ = decisions("50-beam")
    assert steps["data"].decision == "50 variances a record are reduced to 5 numbers"
    assert "uu only together with vv + ww" in steps["unseen directions"].decision
    assert decisions("6-beam")[0]["data"].decision == "all variances are used as they are"


def test_equal_pairs_are_counted_once():
    """Five planes of one beam along the wind: fifteen pairs, five distances along it, and no two more alike."""
    steps, made = decisions("staring-planes")
    assert made.noise.details["n_pairs"] == 15
    assert made.noise.details["n_unique_pairs"] < 15
    assert "repeat another pair's separation" in steps["pairs of beams"].decision


def test_probe_volume_is_integrated_where_it_matters_and_only_there():
    assert decisions("6-beam")[0]["probe volume"].decision == "no probe integral"
    steps, made = decisions("pulsed-4-beam")
    assert steps["probe volume"].decision == "integrated along every beam"
    assert made.noise.details["probe_loss"] > 0.01


def test_shipped_banks_are_named_with_their_error():
    step = decisions("6-beam")[0]["noise of records at other wind speeds and directions"]
    assert step.decision == "interpolated between 35 shipped states"
    assert step.bound.startswith("0.7 % of K")
    other = decisions("6-beam", duration=1800.0)[0]["noise of records at other wind speeds and directions"]
    assert "computed where the records are" in other.decision


def test_lines_to_print_hold_all_of_it():
    _, made = decisions("staring")
    text = "\n".join(made.lines())
    for step in made.steps:
        assert step.decision in text
        assert step.bound in text


def test_bad_options_are_refused():
    with pytest.raises(InputError, match="Unknown prior 'vague'"):
        decisions("staring", prior="vague")
