"""Nonlinear dynamics of rocket-sled slippers: batched, differentiable and fast."""

import importlib.metadata

import jax
import lazy_loader

jax.config.update("jax_enable_x64", True)

__version__ = importlib.metadata.version("slipperjax")
# the public names are in __init__.pyi
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
