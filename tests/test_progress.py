"""The progress bar."""

from bayes_rs.progress import progress, progress_counter


def test_silent_where_stderr_is_no_terminal(capfd):
    assert list(progress(range(3), 3, "boxes")) == [0, 1, 2]
    assert capfd.readouterr().err == ""


def test_a_bar_on_request(capfd):
    assert list(progress(iter("ab"), 2, "boxes", disable=False)) == ["a", "b"]
    captured = capfd.readouterr()
    assert "boxes" in captured.err
    assert captured.out == ""


def test_a_program_without_stderr_has_no_progress(monkeypatch):
    """Python sets it to None where a program was started with it closed."""
    monkeypatch.setattr("sys.stderr", None)
    assert list(progress([1, 2], 2, "counting")) == [1, 2]
    with progress_counter(2, "counting", " things") as bar:
        bar.update(2)
