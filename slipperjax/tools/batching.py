"""Batches of pytrees of one structure: leaves that differ have a leading axis, all others are shared."""

from collections.abc import Callable
from typing import Any, Generic, TypeVar

import equinox as eqx
import jax
import numpy as np

Tree = TypeVar("Tree")


class Batched(eqx.Module, Generic[Tree]):
    """A batch of pytrees of one structure, such as the scenes of a sweep.

    Sharing saves memory and time: values that depend on shared leaves alone are computed once per batch inside a
    compiled program, not once per lane.
    """

    varied: Tree
    """The leaves that differ, with a leading axis of cases; None in place of shared leaves."""
    shared: Tree
    """The leaves that all cases share; None in place of varied leaves."""

    @classmethod
    def of(cls, tree: Tree, like: Tree) -> "Batched[Tree]":
        """Makes a batch; the leaves of `tree` with one axis more than those of `like`, a single case, vary."""
        more = jax.tree.map(lambda a, b: np.ndim(a) > np.ndim(b), tree, like)
        return cls(*eqx.partition(tree, more))

    def map(self, fun: Callable, *batches: Any) -> Any:
        """Applies `fun(tree, *batches)` to each case by `jax.vmap`; `batches` have a leading axis of cases."""
        one = lambda varied, batches: fun(eqx.combine(varied, self.shared), *batches)
        return jax.vmap(one)(self.varied, batches)

    def apply(self, fun: Callable) -> "Batched":
        """Applies `fun(tree)` to each case; of the result, what depends on shared leaves alone is shared. Pure."""
        one = lambda varied: fun(eqx.combine(varied, self.shared))
        first = jax.tree.map(lambda leaf: leaf[0], self.varied)
        leaves, structure = jax.tree.flatten(jax.eval_shape(one, first))

        def is_shared(k: int) -> bool:
            try:
                jax.eval_shape(jax.vmap(lambda varied: jax.tree.leaves(one(varied))[k], out_axes=None), self.varied)
            except ValueError:
                return False
            return True

        shared = [not jax.tree.leaves(self.varied) or is_shared(k) for k in range(len(leaves))]
        keep = lambda wanted: structure.unflatten([same == wanted for same in shared])
        of_all = lambda varied, wanted: eqx.filter(one(varied), keep(wanted))
        varied = None if all(shared) else jax.vmap(lambda varied: of_all(varied, False))(self.varied)
        return Batched(of_all(first, False) if varied is None else varied, of_all(first, True))

    def take(self, index: np.ndarray) -> "Batched[Tree]":
        """The cases at `index`, an array of integers of shape (cases,)."""
        return Batched(jax.tree.map(lambda leaf: leaf[index], self.varied), self.shared)
