"""Nonlinear dynamics of rocket-sled slippers: batched, differentiable and fast."""

import importlib.metadata
import sys

import jax
import lazy_loader

from .tools.compile import warn_if_told_otherwise as _warn_if_told_otherwise

_warn_if_told_otherwise()
jax.config.update("jax_enable_x64", True)

__version__ = importlib.metadata.version("slipperjax")
# the public names stand in __init__.pyi
_public, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)


def __getattr__(name: str):
    if name in __all__:
        return _public(name)
    from .tools.names import nearest_public

    near = None if name.startswith("_") else nearest_public(name, __all__)
    hint = f": did you mean {near}?" if near else ""
    raise AttributeError(f"module 'slipperjax' has no attribute {name!r}{hint}")


if "xarray" in sys.modules:  # otherwise with the first dataset that is made
    from .tools import accessor as _accessor  # noqa: F401
