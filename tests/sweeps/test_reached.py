"""Which motions have reached a periodic orbit: from made-up strobes."""

import numpy as np

import slipperjax as sj
from slipperjax.orbits.motions import recurs
from slipperjax.sweeps.reached import is_near, least_period, likely_periods

from ..common import SCALES

WAYS = np.linspace(0.2, 1.0, 10)  # how much each coordinate takes part


def approaching(multiplier, distance=1.0):
    """States of 200 periods with one complex or real multiplier, which end at `distance` * |multiplier|^200."""
    k = np.arange(200)[:, None]
    return (0.3 + distance * np.real(multiplier ** (k + 0j)) * WAYS) * SCALES


def test_the_likely_period_is_the_least_that_recurs_as_closely():
    rng = np.random.default_rng(3)
    cases = {
        "settled": (approaching(0.5), 1),
        "slow": (approaching(0.98), 1),
        "alternating": (approaching(-0.99, distance=0.2), 2),
        "turning by thirds": (approaching(0.98 * np.exp(2j * np.pi / 3)), 3),
        "of period 3": (np.tile(rng.uniform(-1, 1, (3, 10)), (67, 1))[:200] * SCALES, 3),
        "torus": (np.cos(2.4 * np.arange(200)[:, None] + np.arange(10)) * SCALES, 0),
        "noise": (rng.uniform(-1, 1, (200, 10)) * SCALES, 0),
        "far from settled": (approaching(0.999, distance=50), 0),
        "not finite": (np.full((200, 10), np.nan), 0),
    }
    found = likely_periods(np.array([strobe for strobe, _ in cases.values()]))
    assert dict(zip(cases, found.tolist(), strict=True)) == {name: n for name, (_, n) in cases.items()}
    assert likely_periods(approaching(0.3)[None, :20]).tolist() == [1]


def test_a_motion_must_be_near_and_come_nearer():
    at = 0.3 * np.ones((1, 10)) * SCALES
    # the record of a path of period 3 ends at the path's start
    path = np.array([[0.0], [1.0], [5.0]]) * SCALES
    record = np.tile(path, (40, 1))
    leaving = approaching(1.02, distance=1e-4)
    assert np.max(np.abs(leaving[-1] - at[0]) / SCALES) < 0.05  # still near
    for strobe, orbit, near in (
        (approaching(0.98), at, True),
        (approaching(-0.99, distance=0.2), at, True),
        (np.tile(at, (20, 1)), at, True),
        (record[:-2], path, True),
        (record, path, False),
        (approaching(0.98)[::-1], at, False),
        (approaching(0.98), at + 0.1 * SCALES, False),  # another orbit
        (leaving, at, False),
    ):
        assert is_near(strobe, orbit) == near


def test_the_least_period_divides_the_path():
    two = np.array([[0.0], [1.0]]) * SCALES
    paths = np.tile(two, (3, 1)), np.tile(two[:1], (4, 1)), np.concatenate([two, two + 1e-3 * SCALES])
    assert [least_period(path) for path in paths] == [2, 1, 4]


def test_tracks_recur_or_do_not():
    for wavelengths, does in (((8.0, 4.0, 2.0), True), ((8.0, 3.0), False), ((8.0, 4.000001), False)):
        assert bool(recurs(sj.paper_scene(wavelengths=wavelengths))) == does, wavelengths
