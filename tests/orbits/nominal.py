"""The nominal scene and one number of steps, so that tests of orbits share their compiled programs."""

import slipperjax as sj

SCENE = sj.paper_scene()
STEPS = 96
"""Steps per period, all of which trajectories save by default: no multiple of 50."""
