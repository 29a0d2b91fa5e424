"""Fitting: parameters from measured signals, with reliable intervals."""

from .course import Windows as Windows
from .features import (
    AbstractFeature as AbstractFeature,
    BandRms as BandRms,
    ContactFraction as ContactFraction,
    CorrelationIntegral as CorrelationIntegral,
    ImpactRate as ImpactRate,
    Peaks as Peaks,
)
from .fit import Fit as Fit
from .likelihood import FeaturePosterior as FeaturePosterior, Features as Features
from .method import AbstractFitMethod as AbstractFitMethod, Posterior as Posterior, Problem as Problem
from .synthetic import synthetic_record as synthetic_record
from .telemetry import telemetry as telemetry
from .trajectories import SignalPosterior as SignalPosterior, Trajectories as Trajectories
