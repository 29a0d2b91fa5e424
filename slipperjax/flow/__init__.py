"""One case through time: the period map, trajectories, records, statuses and datasets."""

from .course import Course as Course, Loads as Loads
from .datasets import versions as versions
from .numbers import (
    RECORDS as RECORDS,
    AbstractNumber as AbstractNumber,
    OnePoint as OnePoint,
    PowerMean as PowerMean,
    Record as Record,
)
from .record import (
    AbstractRecord as AbstractRecord,
    History as History,
    PoincareSections as PoincareSections,
    RecordedSpan as RecordedSpan,
    Strobe as Strobe,
)
