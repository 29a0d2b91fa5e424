"""Broadcasting between ranks must be spelt out: what is silent there is mostly a mistake."""

import jax

jax.config.update("jax_numpy_rank_promotion", "raise")
