"""The language of the code: the field's words, one meaning a name, no dialect.

ruff holds the imperative mood of docstrings (D401) and their sections (D417).
"""

import ast
import re
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = sorted(f"roadtorch/{path.parent.name}" for path in ROOT.glob("roadtorch/*/__init__.py"))
FOLDERS = [*PACKAGES, "scripts", "train"]

OPENERS = (
    "a all an any both each every here how its no none nothing of one only some such that the their"
    " there these they this those what when where whether which who whose why with without"
)
"""Words with which no docstring of a function begins: it begins with a verb."""

PRONOUNS = (
    "another anybody asked before beside both drawn each found given held here his its kept known"
    " mine now nobody one other others own rest said same seen shown some stood such taken"
    " that there these this those told wanted what which who whose"
)
"""Words that are no variable's name: a variable is called by the thing that it holds."""

PROTOCOLS = {"ENTRIES"}
"""Names that several modules define so that another can ask each for it."""

Function = ast.FunctionDef | ast.AsyncFunctionDef


def sources(folder: str) -> Iterator[tuple[str, ast.Module]]:
    for path in sorted((ROOT / folder).rglob("*.py")):
        yield str(path.relative_to(ROOT)), ast.parse(path.read_text(encoding="utf-8"))


def is_property(function: Function) -> bool:
    return any(ast.unparse(item).endswith("property") for item in function.decorator_list)


def variables(tree: ast.AST) -> Iterator[tuple[str, int]]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            yield node.id, node.lineno
        elif isinstance(node, ast.arg):
            yield node.arg, node.lineno
        elif isinstance(node, ast.ExceptHandler) and node.name:
            yield node.name, node.lineno


def public_names(tree: ast.Module) -> Iterator[str]:
    for node in tree.body:
        if isinstance(node, Function | ast.ClassDef):
            names = [node.name]
        elif isinstance(node, ast.Assign | ast.AnnAssign):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            names = [
                part.id for item in targets for part in ast.walk(item) if isinstance(part, ast.Name)
            ]
        else:
            names = []
        yield from (name for name in names if not name.startswith("_"))


@pytest.mark.parametrize("folder", FOLDERS)
def test_docstrings_of_functions_begin_with_a_verb(folder: str) -> None:
    wrong = [
        f"{path}:{node.lineno} {node.name}: {text.splitlines()[0]}"
        for path, tree in sources(folder)
        for node in ast.walk(tree)
        if isinstance(node, Function) and not is_property(node)
        if (text := ast.get_docstring(node))
        and text.split()[0].lower().strip(",:;") in OPENERS.split()
    ]

    assert not wrong, "\n".join(wrong)


@pytest.mark.parametrize("folder", FOLDERS)
def test_variables_are_called_by_the_thing_that_they_hold(folder: str) -> None:
    wrong = [
        f"{path}:{line} {name}"
        for path, tree in sources(folder)
        for name, line in variables(tree)
        if name.strip("_") in PRONOUNS.split()
    ]

    assert not wrong, "\n".join(wrong)


@pytest.mark.parametrize("folder", FOLDERS)
def test_an_image_has_one_name(folder: str) -> None:
    wrong = [
        f"{path}:{number} {line.strip()}"
        for path in sorted((ROOT / folder).rglob("*"))
        if path.suffix in {".py", ".js", ".html", ".css"}
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1)
        if re.search(r"(?<!docs/)(?<!readme_)picture(?!s\.csv)", line, re.IGNORECASE)
    ]

    assert not wrong, "\n".join(wrong)


def test_a_public_name_is_defined_in_one_module() -> None:
    modules = defaultdict(set)
    for path, tree in sources("roadtorch"):
        for name in public_names(tree):
            modules[name].add(path)

    several = {name: sorted(paths) for name, paths in modules.items() if len(paths) > 1}
    assert not {name: paths for name, paths in several.items() if name not in PROTOCOLS}
