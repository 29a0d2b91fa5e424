"""Checks shapes and types of stores in processes that tests start with this folder on Python's path.

Python imports it by itself. All of the package would take each process seven seconds more; stores are what other
processes run that tests do not run in their own.
"""

from jaxtyping import install_import_hook

import tests.shapes  # noqa: F401  (the hook finds it by its name)

install_import_hook("slipperjax.sweeps.store", "tests.shapes.typechecked")
