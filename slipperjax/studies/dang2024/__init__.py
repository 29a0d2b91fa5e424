"""The study of Dang et al. 2024, doi:10.1115/1.4065629: its figures, and its claims answered one by one."""

from .claims import CLAIMS as CLAIMS
from .claims import Answer as Answer
from .claims import write_report as write_report
from .figures import write_figures as write_figures
from .runs import FIGURES as FIGURES
from .runs import FULL as FULL
from .runs import MAPS as MAPS
from .runs import QUICK as QUICK
from .runs import readings as readings
from .runs import reproduce as reproduce
