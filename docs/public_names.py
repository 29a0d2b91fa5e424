"""Griffe extension: what the API pages show of the package, and how."""

from typing import Any

import griffe

LONGEST_VALUE = 60
"""Longest default or constant that is shown, in characters."""

ROOMS = ("model", "flow", "sweeps", "orbits", "design", "fitting", "solvers", "tools")
"""The order in which the page of the top level goes through them."""


class PublicNames(griffe.Extension):
    """Shows what the `__init__` files import, and leaves out what has no meaning for a reader."""

    def on_package(self, *, pkg: griffe.Module, **kwargs: Any) -> None:
        """Publishes the imports of `__init__` files and tidies classes, once the whole package is read."""
        modules, classes = {}, []
        found: list[Any] = [pkg]
        while found:
            here = found.pop()
            if here.is_module:
                modules[here.path] = here
            else:
                classes.append(here)
            found += [
                m
                for m in here.members.values()
                if not m.is_alias and (m.is_module or m.is_class)
            ]
        for module in modules.values():
            if module.is_init_module:
                _publish_imports(module, modules)
        for cls in classes:
            _drop_undocumented_methods(cls)

    def on_attribute(self, *, attr: griffe.Attribute, **kwargs: Any) -> None:
        """Shows the default of a field instead of the call that makes the field, and no long values."""
        if str(attr.value).startswith("eqx.field("):
            given = {
                getattr(argument, "name", None): argument for argument in attr.value.arguments
            }
            attr.value = given["default"].value if "default" in given else None
        if len(str(attr.value)) > LONGEST_VALUE:
            attr.value = None


def _publish_imports(module: griffe.Module, modules: dict[str, griffe.Module]) -> None:
    """Makes the names that an `__init__` file imports from the package public members.

    Functions stand first, then classes, values, and base classes; at the top level room by room.
    Griffe drops a name that is also that of a submodule, such as `sweep` from `.sweep`; here the name wins, as in
    Python.
    """
    for name in ("__getattr__", "__version__"):
        module.members.pop(name, None)
    origins = {
        name: _origin(path, modules)
        for name, path in module.imports.items()
        if not name.startswith("_")
    }
    shown = {
        name: origin
        for name, origin in origins.items()
        if origin is not None and not origin.is_module
    }
    for line, (name, origin) in enumerate(
        sorted(shown.items(), key=lambda item: _place(*item))
    ):
        module.members[name] = griffe.Alias(
            name, origin, lineno=line, endlineno=line, parent=module
        )
        module.members[name].public = True


def _place(name: str, origin: Any) -> tuple[int, int]:
    """Where a name stands on its page."""
    last = name.startswith("Abstract") or ".plots.style." in origin.path  # to build on
    kind = 3 if last else 0 if origin.is_function else 1 if origin.is_class else 2
    room = origin.path.split(".")[1]
    return kind, ROOMS.index(room) if room in ROOMS else 0


def _origin(path: str, modules: dict[str, griffe.Module]) -> Any:
    """The object that an import path leads to through the package's modules; None for other packages' objects."""
    parent, _, name = path.rpartition(".")
    if parent not in modules:
        return None
    onward = modules[parent].imports.get(name, path)
    return modules[parent].members.get(name) if onward == path else _origin(onward, modules)


def _drop_undocumented_methods(cls: griffe.Class) -> None:
    """Removes methods without a docstring: they implement an interface that is documented elsewhere."""
    functions = [
        name
        for name, m in cls.members.items()
        if not m.is_alias and m.is_function and m.docstring is None
    ]
    for name in functions:
        if name != "__init__":  # its arguments are the class's
            del cls.members[name]
