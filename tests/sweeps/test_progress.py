"""Progress of a run: a bar on terminals, lines in pipes, and nothing where none is wanted."""

import sys

from slipperjax.sweeps.engine import progress_shown


def test_a_bar_tells_work_and_finished_cases(capsys, monkeypatch):
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    with progress_shown(100.0, 10, "exponents", True) as shown:
        shown(0.0)
        shown(50.0, 4)
        shown(60.0, 6)  # more than all, by rounding
    text = capsys.readouterr().err
    assert "exponents: 100%" in text
    assert "10 of 10 cases" in text


def test_pipes_get_few_lines(capsys):
    with progress_shown(1000.0, 10, "", True) as shown:
        for _ in range(1000):
            shown(1.0)
    text = capsys.readouterr().err
    assert "\r" not in text
    assert 0 < len(text.split("\n")) < 6


def test_nothing_is_shown_unless_it_is_wanted(capsys):
    with progress_shown(10.0, 10, "orbits", False) as shown:
        shown(10.0, 10)
    assert capsys.readouterr().err == ""
