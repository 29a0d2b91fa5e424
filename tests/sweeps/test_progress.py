"""Progress of a run: a bar on terminals, lines in pipes, and nothing where none is wanted."""

import sys

from slipperjax.sweeps.engine import progress_shown


def test_a_bar_shows_work_and_finished_cases_and_pipes_get_few_lines(capsys, monkeypatch):
    with progress_shown(1000.0, 10, "", True) as shown:
        for _ in range(1000):
            shown(1.0)
    text = capsys.readouterr().err
    assert "\r" not in text
    assert 0 < len(text.split("\n")) < 6
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    for wanted in (True, False):
        with progress_shown(100.0, 10, "exponents", wanted) as shown:
            shown(50.0, 4)
            shown(60.0, 6)  # more than all, by rounding
        text = capsys.readouterr().err
        assert ("exponents: 100%" in text and "10 of 10 cases" in text) if wanted else text == ""
