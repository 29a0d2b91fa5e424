"""One case through time: the period map, trajectories, records, statuses and datasets."""

from .course import Course as Course
from .course import Loads as Loads
from .datasets import versions as versions
from .load import dataset_of as dataset_of
from .load import load_call as load_call
from .record import AbstractRecord as AbstractRecord
from .record import RecordedSpan as RecordedSpan
from .records import RECORDS as RECORDS
from .records import AbstractNumber as AbstractNumber
from .records import ForcePercentile as ForcePercentile
from .records import OnePoint as OnePoint
from .records import PowerMean as PowerMean
from .records import Record as Record
from .records import SpectrumLines as SpectrumLines
from .series import History as History
from .series import Sections as Sections
from .series import Strobe as Strobe
from .simulate import Peak as Peak
from .simulate import Probe as Probe
