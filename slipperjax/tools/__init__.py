"""General tools, independent of slippers and dynamics: compiling, batching, fused sums, checks of arguments."""

from .batching import Batched as Batched
from .compile import call_compiled as call_compiled
from .compile import compiler_options as compiler_options
from .compile import is_traced as is_traced
from .compile import jit as jit
from .fused import materialise as materialise
from .fused import sums as sums
from .validate import ImplausibleWarning as ImplausibleWarning
from .validate import ShapeChecked as ShapeChecked
from .validate import brief as brief
from .validate import finite as finite
from .validate import fraction as fraction
from .validate import instance as instance
from .validate import not_negative as not_negative
from .validate import number as number
from .validate import one_of as one_of
from .validate import optional as optional
from .validate import positive as positive
from .validate import unless_traced as unless_traced
from .validate import warn as warn
from .validate import warn_unless_within as warn_unless_within
from .validate import whole as whole
from .validate import yes_or_no as yes_or_no
