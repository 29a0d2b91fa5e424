"""Fitting: parameters from measured signals, with honest intervals."""

from .course import Windows as Windows
from .method import AbstractMethod as AbstractMethod, Posterior as Posterior, Problem as Problem
from .result import Fit as Fit
from .sensors import Sensor as Sensor
from .trajectories import Trajectories as Trajectories
