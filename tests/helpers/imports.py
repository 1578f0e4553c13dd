"""What the project's modules import, read from their text: the rooms of the library and the arrows between them."""

import ast
from collections.abc import Iterable, Iterator, Mapping, Set
from pathlib import Path

ROOT = Path(__file__).parents[2]
SOURCE = ROOT / "src"
LIBRARY = SOURCE / "pointnetkl"


def imported(file: Path) -> Iterator[Path]:
    """Yield the modules of the library that importing a file runs, directly: with a module, its packages."""
    for name in _names(file):
        yield from module_files(name)


def named(file: Path) -> set[Path]:
    """Return the modules of the library that a file names in its imports, without their packages."""
    return {files[-1] for name in _names(file) if (files := list(module_files(name)))}


def _names(file: Path) -> Iterator[str]:
    """Yield the dotted names that a file imports, but for those that only its types use."""
    for node in _statements(ast.parse(file.read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def _statements(node: ast.AST) -> Iterator[ast.AST]:
    """Yield a tree's nodes, leaving out what stands below `if TYPE_CHECKING`."""
    yield node
    if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
        return
    for child in ast.iter_child_nodes(node):
        yield from _statements(child)


def module_files(name: str) -> Iterator[Path]:
    """Yield the files that importing a dotted name of the library runs, but for the library's own: it imports none."""
    parts = name.split(".")
    if parts[0] != LIBRARY.name:
        return
    for depth in range(2, len(parts) + 1):
        path = SOURCE.joinpath(*parts[:depth])
        if path.with_suffix(".py").exists():
            yield path.with_suffix(".py")
        elif (path / "__init__.py").exists():
            yield path / "__init__.py"


def closure(script: Path) -> set[Path]:
    """Return every module of the library that running a script imports, but for those that hold a docstring only."""
    seen: set[Path] = set()
    waiting = [script]
    while waiting:
        for module in imported(waiting.pop()):
            if module not in seen:
                seen.add(module)
                waiting.append(module)
    return {module for module in seen if holds_code(module)}


def holds_code(module: Path) -> bool:
    """Whether a module is more than the docstring (and the version) that makes a folder a package."""
    return any(not isinstance(node, ast.Expr | ast.Assign) for node in ast.parse(module.read_text()).body)


def modules() -> list[Path]:
    """Return every module of the library that holds code."""
    return [path for path in sorted(LIBRARY.rglob("*.py")) if holds_code(path)]


def room(module: Path) -> str:
    """Return the folder of a module below the library: `slam/graph`; of the library's own modules, the empty text."""
    folder = module.parent.relative_to(LIBRARY).as_posix()
    return "" if folder == "." else folder


def arrows(files: Iterable[Path], depth: int = 9) -> dict[str, set[str]]:
    """Return the rooms that each room of some modules imports, itself left out; rooms deeper than `depth` in one."""
    rooms: dict[str, set[str]] = {}
    for file in files:
        others = {_cut(room(module), depth) for module in named(file) if holds_code(module)}
        name = _cut(room(file), depth)
        rooms.setdefault(name, set()).update(others - {name})
    return rooms


def _cut(room: str, depth: int) -> str:
    return "/".join(room.split("/")[:depth])


def circle(arrows: Mapping[str, Set[str]]) -> list[str]:
    """Return a path from a node back to itself, or an empty list where there is none."""
    done: set[str] = set()
    for start in sorted(arrows):
        if path := _circle_from(start, arrows, [], done):
            return path
    return []


def _circle_from(node: str, arrows: Mapping[str, Set[str]], path: list[str], done: set[str]) -> list[str]:
    if node in path:
        return [*path[path.index(node) :], node]
    if node in done:
        return []
    for other in sorted(arrows.get(node, ())):
        if circle := _circle_from(other, arrows, [*path, node], done):
            return circle
    done.add(node)
    return []
