"""One case through time: the period map, trajectories, recorders, statuses and datasets."""

from .course import Course as Course
from .datasets import versions as versions
from .load import dataset_of as dataset_of
from .load import load_call as load_call
from .loads import Loads as Loads
from .loads import contact_loads as contact_loads
from .percentiles import ForcePercentile as ForcePercentile
from .reducers import REDUCERS as REDUCERS
from .reducers import Extremes as Extremes
from .reducers import PointLoad as PointLoad
from .reducers import Reduced as Reduced
from .reducers import RMSAccelerations as RMSAccelerations
from .reducers import SectionPoints as SectionPoints
from .reducers import StrobeStates as StrobeStates
from .reducing import AbstractReducer as AbstractReducer
from .reducing import PeriodView as PeriodView
from .reducing import Stretch as Stretch
from .simulate import Peak as Peak
from .simulate import Probe as Probe
from .spectra import SpectrumLines as SpectrumLines
