"""The progress bar."""

from bayes_rs.progress import progress


def test_silent_where_stderr_is_no_terminal(capfd):
    assert list(progress(range(3), 3, "boxes")) == [0, 1, 2]
    assert capfd.readouterr().err == ""


def test_a_bar_on_request(capfd):
    assert list(progress(iter("ab"), 2, "boxes", disable=False)) == ["a", "b"]
    captured = capfd.readouterr()
    assert "boxes" in captured.err
    assert captured.out == ""
