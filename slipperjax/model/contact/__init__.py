"""Contact: normal force laws, and the memory of the rate at touchdown."""

from .laws import AbstractContactLaw as AbstractContactLaw
from .laws import ConstantDamping as ConstantDamping
from .laws import Flores as Flores
from .laws import HertzSpring as HertzSpring
from .laws import HuntCrossley as HuntCrossley
from .laws import LankaraniNikravesh as LankaraniNikravesh
from .laws import zero_safe_sqrt as zero_safe_sqrt
from .memory import AbstractMemory as AbstractMemory
from .memory import Before as Before
from .memory import EventLatch as EventLatch
from .memory import SmoothSwitch as SmoothSwitch
