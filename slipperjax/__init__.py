"""Nonlinear dynamics of rocket-sled slippers: batched, differentiable and fast."""

import importlib.metadata
import sys

import jax
import lazy_loader

from .tools.compile import loops_in_one_kernel as _loops_in_one_kernel

jax.config.update("jax_enable_x64", True)
_loops_in_one_kernel()

__version__ = importlib.metadata.version("slipperjax")
# the public names stand in __init__.pyi
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

if "xarray" in sys.modules:  # otherwise with the first dataset that is made
    from .flow import accessor as _accessor  # noqa: F401
