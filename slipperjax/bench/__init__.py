"""Error against cost: every solver on easy and hard scenes, beside other codes that integrate the same model."""

from .measure import bench as bench
from .measure import cost_of as cost_of
from .measure import errors as errors
from .methods import METHODS as METHODS
from .methods import Case as Case
from .methods import Method as Method
from .methods import all_cases as all_cases
from .peers import PEERS as PEERS
from .peers import AbstractPeer as AbstractPeer
from .peers import CppPeer as CppPeer
from .peers import NumpyModel as NumpyModel
from .peers import SciPyPeer as SciPyPeer
from .rates import ENGINES as ENGINES
from .rates import Rate as Rate
from .rates import rows as rows
from .rates import throughput as throughput
from .work_precision import Point as Point
from .work_precision import cost_at as cost_at
from .work_precision import draw as draw
from .work_precision import draw_all as draw_all
from .work_precision import mbdyn_points as mbdyn_points
from .work_precision import table as table
from .work_precision import write as write
