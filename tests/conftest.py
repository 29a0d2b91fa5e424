"""Shapes and types of the package's annotations are enforced; broadcasting between ranks must be spelt out."""

import os

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
        import slipperjax.analysis
        import slipperjax.bench
        import slipperjax.cli
        import slipperjax.design
        import slipperjax.flow
        import slipperjax.model
        import slipperjax.orbits
        import slipperjax.plots
        import slipperjax.solvers
        import slipperjax.studies.dang2024
        import slipperjax.sweeps
        import slipperjax.tools  # noqa: F401
