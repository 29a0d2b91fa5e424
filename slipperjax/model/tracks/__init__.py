"""Tracks: the rail's irregularity as functions of distance."""

from .abstract import AbstractTrack as AbstractTrack
from .abstract import Irregularity as Irregularity
from .harmonic import HarmonicTrack as HarmonicTrack
from .harmonic import StraightTrack as StraightTrack
