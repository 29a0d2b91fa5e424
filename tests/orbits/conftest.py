"""The nominal orbit, which several files look at."""

import pytest


@pytest.fixture(scope="session")
def nominal():
    # not above: this file is read before the package may be imported, see tests/conftest.py
    import slipperjax as sj

    from .nominal import SCENE, STEPS

    return sj.periodic_orbit(SCENE, steps_per_period=STEPS)
