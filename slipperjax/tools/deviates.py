"""Random numbers of a seed, which are the same in every program, on every device and with every setting of JAX.

The generator is Threefry-2x32 with 20 rounds (doi:10.1145/2063384.2063405) as a hash of a key and a count. Neither
`jax_default_prng_impl` nor `jax_threefry_partitionable` changes the numbers. Both options would change the results of
`jax.random.split` and `jax.random.normal`.
"""

import math

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Key


def keys_of(seed: Array, count: int) -> Key[Array, " count"]:
    """Return the keys of `count` independent series of a seed, a whole number below 2^53."""
    return _hashed(jax.random.key(seed.astype(int), impl="threefry2x32"), count)


def uniform(key: Key[Array, ""], shape: tuple[int, ...]) -> Float[Array, "..."]:
    """Return numbers evenly distributed over [0, 1), multiples of 2^-52."""
    words = jax.random.key_data(_hashed(key, math.prod(shape))).astype(jnp.uint64)
    return ((words[:, 0] << 32 | words[:, 1]) >> 12).astype(float).reshape(shape) * 2.0**-52


def normal(key: Key[Array, ""], shape: tuple[int, ...]) -> Float[Array, "..."]:
    """Return normal deviates of mean 0 and variance 1."""
    low = np.nextafter(-1.0, 0.0)  # the deviate of -1 would be infinite
    return np.sqrt(2) * jax.lax.erf_inv(jnp.maximum(low, uniform(key, shape) * (1 - low) + low))


def _hashed(key: Key[Array, ""], count: int) -> Key[Array, " count"]:
    return jax.vmap(jax.random.fold_in, (None, 0))(key, jnp.arange(count))
