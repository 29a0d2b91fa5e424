"""Many pytrees of one structure as one: what differs between them has a leading axis, the rest is shared."""

from collections.abc import Callable
from typing import Any, Generic, TypeVar

import equinox as eqx
import jax
import numpy as np

Tree = TypeVar("Tree")


class Batched(eqx.Module, Generic[Tree]):
    """A batch of pytrees of one structure, such as the scenes of a sweep.

    Sharing what does not differ is more than a saving of memory: a number that is the same for all lanes is computed
    once per batch inside a compiled program, and not once per lane.
    """

    varied: Tree
    """The leaves that differ, with a leading axis of cases; None in the place of the others."""
    shared: Tree
    """The leaves that all cases share; None in the place of the others."""

    @classmethod
    def of(cls, tree: Tree, like: Tree) -> "Batched[Tree]":
        """A batch from a tree in which some leaves have one axis more than those of `like`, a single case."""
        more = jax.tree.map(lambda a, b: np.ndim(a) > np.ndim(b), tree, like)
        return cls(*eqx.partition(tree, more))

    def map(self, fun: Callable, *batches: Any) -> Any:
        """`fun(tree, *one of each batch)` for all cases, by `jax.vmap`; `batches` have a leading axis of cases."""
        one = lambda varied, batches: fun(eqx.combine(varied, self.shared), *batches)
        return jax.vmap(one)(self.varied, batches)

    def take(self, index: np.ndarray) -> "Batched[Tree]":
        """The cases at some places."""
        return Batched(jax.tree.map(lambda leaf: leaf[index], self.varied), self.shared)
