"""One case through time: the period map, trajectories, records, statuses and datasets."""

from .course import Course as Course
from .course import Loads as Loads
from .datasets import dataset_of as dataset_of
from .datasets import load_call as load_call
from .datasets import versions as versions
from .record import AbstractRecord as AbstractRecord
from .record import History as History
from .record import RecordedSpan as RecordedSpan
from .record import Sections as Sections
from .record import Strobe as Strobe
from .records import RECORDS as RECORDS
from .records import AbstractNumber as AbstractNumber
from .records import OnePoint as OnePoint
from .records import PowerMean as PowerMean
from .records import Record as Record
from .simulate import Peak as Peak
from .simulate import Probe as Probe
