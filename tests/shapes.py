"""The type checker of the tests: jaxtyping's shapes by beartype."""

import typing

import beartype
from jaxtyping import AbstractArray


def mentions_arrays(annotation: typing.Any) -> bool:
    """Whether an annotation has a jaxtyping array anywhere inside."""
    if isinstance(annotation, type) and issubclass(annotation, AbstractArray):
        return True
    return any(map(mentions_arrays, typing.get_args(annotation)))


def typechecked(function: typing.Any) -> typing.Any:
    """beartype for arguments that are arrays, and for all results.

    Other arguments are left to the package's own checks, whose errors the tests of bad input want to see. Results
    named by a text with a dot, such as "xr.Dataset", are of libraries that are imported late.
    """
    late = lambda annotation: isinstance(annotation, str) and "." in annotation
    function.__annotations__ = {
        name: annotation
        for name, annotation in function.__annotations__.items()
        if mentions_arrays(annotation) or (name == "return" and not late(annotation))
    }
    return beartype.beartype(function)
