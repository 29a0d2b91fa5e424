"""Names of regimes, and standard errors of several motions."""

import numpy as np
import pytest

from slipperjax.analysis.kinds import KINDS, REGIMES, Regime
from slipperjax.analysis.lyapunov import pooled_standard_error, regime, standard_error

from .systems import autoregression


@pytest.mark.parametrize(
    ("exponent", "stderr", "kind", "trusted", "escapes", "name"),
    [
        (0.30, 0.02, "chaotic", True, 0, "chaotic"),
        (0.30, 0.02, "unresolved", True, 0, "chaotic"),
        (0.30, 0.02, "chaotic", True, 1, "transient chaos"),
        (0.30, 0.02, "chaotic", False, 0, "unresolved"),
        (-0.05, 0.002, "period", True, 0, "periodic"),
        (0.000, 0.001, "torus", True, 0, "regular"),
        (0.50, 0.21, "unresolved", True, 0, "unresolved"),  # neither positive nor known to be zero
        (-0.053, 0.007, "chaotic", True, 0, "unresolved"),  # exponent and recurrence contradict each other
        (0.30, 0.02, "period", True, 0, "unresolved"),
        (np.nan, 0.02, "chaotic", True, 0, "unresolved"),
    ],
)
def test_a_name_needs_an_exponent_that_is_known_and_agrees(exponent, stderr, kind, trusted, escapes, name):
    assert regime(exponent, stderr, kind, trusted, escapes) == name


def test_several_motions_show_correlations_as_long_as_a_record():
    """An autoregression that forgets within 100 of 500 intervals: 300 times of four motions."""
    history = autoregression(np.exp(-1 / 100), 500, 1200)[0].reshape(300, 4, 500, 1)
    scatter = history.mean(axis=(1, 2, 3)).std()
    stated = np.sqrt(np.mean(pooled_standard_error(history) ** 2))
    alone = np.sqrt(np.mean(standard_error(history) ** 2) / 4)
    # measured: 1.02 of several motions, 1.21 of each alone
    assert 0.8 < scatter / stated < 1.25
    assert scatter / alone > 1.1


def test_one_number_stands_for_both_words():
    assert KINDS == ("period", "torus", "chaotic", "unresolved")
    assert REGIMES == ("periodic", "regular", "chaotic", "unresolved", "transient chaos")
    numbers = Regime.codes(KINDS)
    assert Regime.kind_names(numbers).tolist() == list(KINDS)
    assert Regime.regime_names([*numbers, Regime.TRANSIENT]).tolist() == list(REGIMES)
    # arrays of cases that were not run are zero
    assert Regime.kind_names(np.zeros(2, int)).tolist() == ["unresolved"] * 2
