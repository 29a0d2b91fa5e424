"""Shapes and types of the package's annotations are enforced; broadcasting between ranks must be spelt out."""

import importlib
import os
import pkgutil

import jax
from jaxtyping import install_import_hook

from . import shapes  # noqa: F401  (the hook finds it by its name)

# tests compile for themselves, and leave the user's cache alone
os.environ["SLIPPERJAX_CACHE"] = "off"
# what broadcasts silently is mostly a mistake
jax.config.update("jax_numpy_rank_promotion", "raise")


def pytest_configure(config):
    if config.getoption("markexpr") == "benchmark":
        return  # checks cost time, which benchmarks measure
    with install_import_hook("slipperjax", "tests.shapes.typechecked"):
        import slipperjax

        # all of them now, because the package imports its rooms at their first use, when the hook is gone
        for module in pkgutil.walk_packages(slipperjax.__path__, "slipperjax."):
            importlib.import_module(module.name)
