"""What a package's sources say about it: modules, imports, circles, names. Nothing is imported.

Every ``import`` statement counts: at the top, inside a function, under ``if TYPE_CHECKING``. The
one exception are those under ``if TYPE_CHECKING`` in the package's own ``__init__``: they tell
type checkers about names that are loaded late, when nobody waits for them. Imports by a string,
as of commands and plugins, are not seen.
"""

import ast
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

Graph = Mapping[str, frozenset[str]]
"""Importer → what it imports; every node is a key."""


@dataclass(frozen=True)
class Module:
    """One source file. name: dotted; that of an ``__init__.py`` is its package's."""

    name: str
    path: Path
    source: str

    @cached_property
    def tree(self) -> ast.Module:
        """The syntax tree; SyntaxError when the source has none."""
        return ast.parse(self.source, str(self.path))

    @property
    def lines(self) -> int:
        """How many lines the file has."""
        return len(self.source.splitlines())

    @property
    def package(self) -> str:
        """The package that relative imports start from."""
        return self.name if self.path.name == "__init__.py" else self.name.rpartition(".")[0]


@dataclass(frozen=True)
class Function:
    """A function or method. name: dotted, with its module; lines: from ``def`` to its end."""

    name: str
    lines: int


def read_package(folder: Path) -> dict[str, Module]:
    """The modules of the package in a folder by name, sorted."""
    found = []
    for path in folder.rglob("*.py"):
        parts = path.relative_to(folder.parent).with_suffix("").parts
        name = ".".join(parts[:-1] if path.name == "__init__.py" else parts)
        found.append(Module(name, path, path.read_text(encoding="utf-8")))
    return {module.name: module for module in sorted(found, key=lambda one: one.name)}


# --- imports ----------------------------------------------------------------------------


def import_graph(modules: Mapping[str, Module]) -> Graph:
    """Which module imports which; only those of the package."""
    return {
        module.name: frozenset(_imported(module, modules)) - {module.name}
        for module in modules.values()
    }


def _imported(module: Module, modules: Mapping[str, Module]) -> Iterator[str]:
    is_face = "." not in module.name
    for node in _nodes_at_runtime(module.tree) if is_face else ast.walk(module.tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names if alias.name in modules)
        elif isinstance(node, ast.ImportFrom):
            origin = _origin(module, node)
            for alias in node.names:
                inner = f"{origin}.{alias.name}"
                target = inner if inner in modules else origin
                if target in modules:
                    yield target


def _nodes_at_runtime(node: ast.AST) -> Iterator[ast.AST]:
    """All nodes, save what stands under ``if TYPE_CHECKING``."""
    yield node
    for child in ast.iter_child_nodes(node):
        if not (isinstance(child, ast.If) and ast.unparse(child.test).endswith("TYPE_CHECKING")):
            yield from _nodes_at_runtime(child)


def _origin(module: Module, node: ast.ImportFrom) -> str:
    """The dotted name after ``from``, relative ones made absolute."""
    if not node.level:
        return node.module or ""
    parts = module.package.split(".")
    return ".".join(parts[: len(parts) - node.level + 1] + ([node.module] if node.module else []))


def room_of(name: str) -> str:
    """The room of a module: the folder or module right under the package, or its ``__init__``.

    Every ``__main__``, a folder's too, is in the room of that name: a way in from outside, that
    nothing imports and that may import everything.
    """
    parts = [*name.split("."), "__init__"]
    return "__main__" if "__main__" in parts else parts[1]


def room_graph(graph: Graph) -> Graph:
    """Which room imports which other one."""
    rooms: dict[str, set[str]] = {}
    for importer, imported in graph.items():
        room = room_of(importer)
        rooms.setdefault(room, set()).update(room_of(name) for name in imported)
    return {room: frozenset(imported - {room}) for room, imported in rooms.items()}


def circles(graph: Graph) -> list[tuple[str, ...]]:
    """Groups of more than one node that all reach one another, each sorted; sorted."""
    reach = {node: _reachable(graph, node) for node in graph}
    groups = {tuple(sorted(to for to in reach[node] if node in reach[to])) for node in graph}
    return sorted(group for group in groups if len(group) > 1)


def _reachable(graph: Graph, start: str) -> set[str]:
    found, waiting = set(), [start]
    while waiting:
        for node in graph[waiting.pop()] - found:
            found.add(node)
            waiting.append(node)
    return found


# --- names ------------------------------------------------------------------------------


def public_definitions(module: Module) -> list[str]:
    """The public classes and functions at the top of a module."""
    kinds = (ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
    return _public(node.name for node in module.tree.body if isinstance(node, kinds))


def public_constants(module: Module) -> list[str]:
    """The public names that are assigned at the top of a module, each once."""
    names: dict[str, None] = {}
    for node in module.tree.body:
        if isinstance(node, ast.Assign):
            targets = node.targets
        elif isinstance(node, ast.AnnAssign):
            targets = [node.target]
        else:
            continue
        inside = (part for target in targets for part in ast.walk(target))
        names.update({part.id: None for part in inside if isinstance(part, ast.Name)})
    return _public(names)


def _public(names: Iterable[str]) -> list[str]:
    return [name for name in names if not name.startswith("_")]


def twins(names: Mapping[str, Iterable[str]]) -> dict[str, list[str]]:
    """Names that more than one module defines: name → modules, both sorted.

    names: module → the names that it defines.
    """
    homes: dict[str, list[str]] = {}
    for module, defined in names.items():
        for name in defined:
            homes.setdefault(name, []).append(module)
    return {name: sorted(homes[name]) for name in sorted(homes) if len(homes[name]) > 1}


def functions(module: Module) -> list[Function]:
    """All functions and methods of a module, those inside others too."""
    return list(_functions(module.tree, module.name))


def _functions(node: ast.AST, prefix: str) -> Iterator[Function]:
    for child in ast.iter_child_nodes(node):
        name = prefix
        if isinstance(child, ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            name = f"{prefix}.{child.name}"
        if isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef):
            yield Function(name, (child.end_lineno or child.lineno) - child.lineno + 1)
        yield from _functions(child, name)
