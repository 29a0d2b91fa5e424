"""Batches of pytrees of one structure: leaves that differ have a leading axis, all others are shared."""

from collections.abc import Callable
from typing import Generic, TypeVar

import equinox as eqx
import jax
import numpy as np
from jaxtyping import PyTree

Tree = TypeVar("Tree")


class Batched(eqx.Module, Generic[Tree]):
    """A batch of pytrees of one structure, such as the scenes of a sweep.

    Sharing saves memory and time: inside a compiled program, values that depend on shared leaves alone are computed
    once per batch, not once per case.
    """

    varied: Tree
    """The leaves that differ, with a leading axis of cases; None in place of shared leaves."""
    shared: Tree
    """The leaves that all cases share; None in place of varied leaves."""

    @classmethod
    def of(cls, tree: Tree, like: Tree) -> "Batched[Tree]":
        """Return a batch: leaves of `tree` vary where they have more axes than those of `like`, a single case."""
        more = jax.tree.map(lambda a, b: np.ndim(a) > np.ndim(b), tree, like)
        return cls(*eqx.partition(tree, more))

    def map(self, fun: Callable, *batches: PyTree) -> PyTree:
        """Apply `fun(tree, *batches)` to each case by `jax.vmap`; `batches` have a leading axis of cases."""
        one = lambda varied, batches: fun(eqx.combine(varied, self.shared), *batches)
        return jax.vmap(one)(self.varied, batches)

    def apply(self, fun: Callable) -> "Batched":
        """Apply `fun(tree)` to each case; results that depend on shared leaves alone are shared. Pure."""

        def result(varied: Tree) -> PyTree:
            return fun(eqx.combine(varied, self.shared))

        def is_shared(k: int) -> bool:
            leaf = lambda varied: jax.tree.leaves(result(varied))[k]
            try:
                # JAX refuses results that differ between cases where they are to have no axis of cases
                jax.eval_shape(jax.vmap(leaf, out_axes=None), self.varied)
            except ValueError:
                return False
            return True

        def part(varied: Tree, wanted: bool) -> PyTree:
            # shared results, or all other results, with None in place of the rest
            leaves = jax.tree.leaves(result(varied))
            return structure.unflatten(
                [leaf if same == wanted else None for leaf, same in zip(leaves, shared, strict=True)]
            )

        # the first case gives the shared results; nothing is mapped where all results are shared
        first = jax.tree.map(lambda leaf: leaf[0], self.varied)
        structure = jax.tree.structure(jax.eval_shape(result, first))
        nothing_varies = not jax.tree.leaves(self.varied)
        shared = [nothing_varies or is_shared(k) for k in range(structure.num_leaves)]
        of_cases = part(first, False) if all(shared) else jax.vmap(lambda varied: part(varied, False))(self.varied)
        return Batched(of_cases, part(first, True))

    def case(self, k: int) -> Tree:
        """Return the tree of case number `k`."""
        return eqx.combine(jax.tree.map(lambda leaf: leaf[k], self.varied), self.shared)

    def take(self, index: np.ndarray) -> "Batched[Tree]":
        """Return the cases at `index`, an array of integers of shape (cases,)."""
        return Batched(jax.tree.map(lambda leaf: leaf[index], self.varied), self.shared)
