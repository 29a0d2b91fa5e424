"""Nonlinear dynamics of rocket-sled slippers: batched, differentiable and fast."""

import importlib.metadata
import sys

import jax
import lazy_loader

jax.config.update("jax_enable_x64", True)

__version__ = importlib.metadata.version("slipperjax")
# the public names stand in __init__.pyi
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

if "xarray" in sys.modules:  # otherwise with the first dataset that is made
    from .tools import accessor as _accessor  # noqa: F401
