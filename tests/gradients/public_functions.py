"""Finds, in the source, every public function and public method that takes or returns arrays.

An annotation is of arrays when it names JAX's or NumPy's array, a name of another annotation of arrays, or a class that
holds arrays: one with such a field, one that inherits from such a class, or one that such a class inherits from.
"""

import ast
import dataclasses
import functools
import pathlib
from collections.abc import Iterator

import jaxrelight

ROOT = pathlib.Path(jaxrelight.__file__).parent.parent
PACKAGES = ("jaxrelight", "fitting")
# The package of the entries themselves.
_ENTRIES = ("jaxrelight.gradients", "fitting.gradients")
_ARRAYS = {
    "jax.Array",
    "jaxtyping.Array",
    "numpy.ndarray",
    "jax.typing.ArrayLike",
    "jaxtyping.ArrayLike",
    "numpy.typing.ArrayLike",
    "jaxtyping.PyTree",
}
# A method that returns nothing but these tells a fact of its object: arrays of the object itself do not count.
_PLAIN = {"int", "float", "bool", "str", "None", "tuple", "list", "set", "dict", "object", "typing.Any", "Any"}


@dataclasses.dataclass(frozen=True)
class Module:
    """One parsed module, and what the names in it stand for."""

    name: str
    tree: ast.Module
    names: dict[str, str]


@dataclasses.dataclass(frozen=True)
class PublicFunction:
    """A public function or method that takes or returns arrays.

    Args:
        name: full, of a method with its class.
        jax: whether it takes or returns arrays of JAX, or classes that hold arrays of JAX.
    """

    name: str
    jax: bool


@functools.cache
def modules() -> dict[str, Module]:
    """Every module of the packages, by its full name, but for those of the entries."""
    found = {}
    for package in PACKAGES:
        for path in sorted((ROOT / package).rglob("*.py")):
            name = ".".join(part for part in path.relative_to(ROOT).with_suffix("").parts if part != "__init__")
            if not name.startswith(_ENTRIES):
                found[name] = parsed(name, path.read_text(encoding="utf-8"))
    return found


def parsed(name: str, source: str) -> Module:
    """A module of its source."""
    tree = ast.parse(source)
    names = {}
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names |= {alias.asname or alias.name: alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            names |= {alias.asname or alias.name: f"{node.module}.{alias.name}" for alias in node.names}
    for node in tree.body:
        if isinstance(node, ast.ClassDef):
            names[node.name] = f"{name}.{node.name}"
        elif isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name):
            names[node.targets[0].id] = f"{name}.{node.targets[0].id}"
        elif isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            names[node.target.id] = f"{name}.{node.target.id}"
    return Module(name, tree, names)


def mentioned(annotation: ast.expr | None, names: dict[str, str]) -> Iterator[str]:
    """The full names of what an annotation mentions; what it quotes is read as well."""
    if annotation is None:
        return
    if isinstance(annotation, ast.Constant):
        if isinstance(annotation.value, str):
            try:
                yield from mentioned(ast.parse(annotation.value, mode="eval").body, names)
            except SyntaxError:
                return  # the shape of an array
    elif isinstance(annotation, ast.Name):
        yield names.get(annotation.id, annotation.id)
    elif isinstance(annotation, ast.Attribute):
        head, _, rest = ast.unparse(annotation).partition(".")
        yield f"{names.get(head, head)}.{rest}"
    else:
        for child in ast.iter_child_nodes(annotation):
            if isinstance(child, ast.expr):
                yield from mentioned(child, names)


def holding_arrays(parsed_modules: dict[str, Module], arrays: set[str]) -> set[str]:
    """The full names of all classes and named annotations that hold any of these, and these themselves."""
    holds: dict[str, set[str]] = {}
    bases: dict[str, set[str]] = {}
    for module in parsed_modules.values():
        for node in module.tree.body:
            if isinstance(node, ast.ClassDef):
                name = f"{module.name}.{node.name}"
                fields = [one.annotation for one in node.body if isinstance(one, ast.AnnAssign)]
                fields += [
                    one.returns for one in node.body if isinstance(one, ast.FunctionDef) and one.name == "__call__"
                ]
                holds[name] = {one for field in fields for one in mentioned(field, module.names)}
                bases[name] = {one for base in node.bases for one in mentioned(base, module.names)}
            elif isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name):
                holds[f"{module.name}.{node.targets[0].id}"] = set(mentioned(node.value, module.names))
    found = set(arrays)
    while True:
        more = {name for name, members in holds.items() if members & found}
        more |= {name for name, parents in bases.items() if parents & found}
        more |= {parent for name, parents in bases.items() if name in found for parent in parents if parent in holds}
        if more <= found:
            return found
        found |= more


def public_functions(parsed_modules: dict[str, Module]) -> list[PublicFunction]:
    """All that take or return arrays, in the order of the source."""
    arrays = holding_arrays(parsed_modules, _ARRAYS)
    of_jax = holding_arrays(parsed_modules, {name for name in _ARRAYS if "jax" in name})
    found = {}
    for module in parsed_modules.values():
        for name, function, holder in _public(module):
            given = function.args
            parameters = [*given.posonlyargs, *given.args, *given.kwonlyargs, given.vararg, given.kwarg]
            annotations = [one.annotation for one in parameters if one is not None] + [function.returns]
            used = {one for annotation in annotations for one in mentioned(annotation, module.names)}
            if set(mentioned(function.returns, module.names)) - _PLAIN:
                used |= holder
            if used & arrays:
                jax = bool(used & of_jax) or (name in found and found[name].jax)
                found[name] = PublicFunction(name, jax)
    return list(found.values())


def _public(module: Module) -> Iterator[tuple[str, ast.FunctionDef, set[str]]]:
    """Functions and methods with their full names; for a method, its class."""
    for node in module.tree.body:
        if isinstance(node, ast.FunctionDef) and not node.name.startswith("_"):
            yield f"{module.name}.{node.name}", node, set()
        elif isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
            name = f"{module.name}.{node.name}"
            for member in node.body:
                if isinstance(member, ast.FunctionDef) and not member.name.startswith("_"):
                    yield f"{name}.{member.name}", member, {name}
