"""Nonlinear dynamics of rocket-sled slippers: batched, differentiable and fast."""

import importlib.metadata
import sys

import jax
import lazy_loader

from .tools.first_dataset import WAITING as _WAITING

jax.config.update("jax_enable_x64", True)

__version__ = importlib.metadata.version("slipperjax")
# the public names stand in __init__.pyi
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)


def _add_pictures() -> None:
    """Give all datasets of xarray their pictures, `ds.slipper`."""
    from . import accessor  # noqa: F401


if "xarray" in sys.modules:
    _add_pictures()
else:
    _WAITING.append(_add_pictures)
