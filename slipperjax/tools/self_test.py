"""The self-test of the fast forms: one small program that uses all of them, compared with its plain form.

The test takes 1.5 s, and no time where programs are kept and an earlier test has passed.
"""

import hashlib
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from types import ModuleType

import jax
import jax.numpy as jnp
import jaxlib
import numpy as np
from jaxtyping import Array

from . import fast, plain
from .cache import kept_folder
from .code import IMPORTED
from .files import write_whole

PASSED = b"passed"
"""Content of the file that says that the self-test has passed."""
X = np.array([0.1, 0.5, 0.9])
WEIGHTS = np.linspace(0.5, 1.5, 8)


def fault() -> str:
    """Return what is wrong with the fast forms, "" where nothing is wrong; raises JAX's own errors."""
    file = _file()
    if file is not None:
        with suppress(OSError):
            if file.read_bytes() == PASSED:
                return ""
    # a new thread is outside of transformations, and of contexts such as `jax.disable_jit`
    with ThreadPoolExecutor(1) as pool:
        found, right = pool.map(_computed, (fast, plain))
    if not all(np.allclose(one, other, rtol=1e-9) for one, other in zip(found, right, strict=True)):
        return "it gives wrong numbers"
    if file is not None:
        with suppress(OSError):
            write_whole(file, PASSED)
    return ""


def _file() -> Path | None:
    """Return the file next to kept programs that records a passed self-test; None where no programs are kept."""
    folder = kept_folder()
    if folder is None:
        return None
    of_what = f"{jax.__version__} {jaxlib.__version__} {IMPORTED} {jax.default_backend()}"
    return folder / f"slipperjax-self-test-{hashlib.sha256(of_what.encode()).hexdigest()[:12]}"


def _computed(form: ModuleType) -> tuple[Array, Array, Array]:
    """Return the value of `_run`, its gradient in forward mode, and in reverse mode the gradient of a batch's sum."""
    run = lambda x: _run(form, x)
    of_batch = lambda x: jnp.sum(jax.vmap(run)(jnp.stack([x, 2 * x])))
    every = lambda x: (run(x), jax.jacfwd(run)(x), jax.grad(of_batch)(x))
    # the least effort of LLVM, because errors occur before LLVM begins
    options = form.compiler_options() | {"xla_backend_optimization_level": 0}
    return jax.jit(every, compiler_options=options)(X)


def _run(form: ModuleType, x: Array) -> Array:
    """Return a number after three steps, which use all of the tricks."""

    def step(x, k):
        cosine, sine = form.circle(x[0] + k)
        a, b = form.spread(WEIGHTS.size, *form.store_if_differentiated((cosine * x[1], sine)))
        total, other = form.sums(a * WEIGHTS, jnp.sqrt(1 + b * b) * WEIGHTS)
        turned = jnp.outer(x, x) @ form.store_cotangent(x)
        return 0.1 * turned + jnp.stack([total, other, form.store(total * other)]) / WEIGHTS.size, None

    stepped = lambda x: jax.lax.scan(step, x, jnp.arange(3.0))[0]
    return jnp.sum(form.in_one_kernel(stepped, x))
