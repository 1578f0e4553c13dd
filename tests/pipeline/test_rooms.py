"""The library's rooms: imports run one way, and no room is too large to be read."""

from collections import Counter

import pytest

from imports import LIBRARY, arrows, circle, modules, named, room

# Each room imports from the lines below its own only. docs/architecture.md says what each is for.
LAYERS = (
    ("commands",),
    ("correction",),
    ("estimator", "inspection", "exchange", "authors"),
    ("reporting",),
    ("methods", "training"),
    ("slam", "labels", "models"),
    ("registration", "segmentation", "readers", "simulation"),
    ("surveys",),
    ("workflow",),
)
LAYER = {room: number for number, rooms in enumerate(LAYERS) for room in rooms}
MOST_FILES = 12


def layer_of(name: str) -> int:
    """Return the layer of a room, or of a module of the library's own folder."""
    return LAYER[name.split("/")[0]]


def test_every_room_has_a_layer_and_every_layer_its_rooms():
    folders = {path.parent.name for path in LIBRARY.glob("*/__init__.py")}
    assert folders == LAYER.keys() - {"estimator"}


@pytest.mark.parametrize("name", [name for rooms in LAYERS for name in rooms])
def test_a_room_imports_only_from_layers_below_its_own(name: str):
    files = [path for path in modules() if path.relative_to(LIBRARY).with_suffix("").parts[0] == name]
    upward = {
        (str(file.relative_to(LIBRARY)), str(module.relative_to(LIBRARY)))
        for file in files
        for module in named(file)
        if name != (target := module.relative_to(LIBRARY).with_suffix("").parts[0]) and layer_of(target) <= LAYER[name]
    }
    assert not upward, f"these imports of {name} do not run downward: {sorted(upward)}"


def test_no_module_imports_itself_through_others():
    graph = {path: named(path) - {path} for path in modules()}
    assert not circle({str(path): set(map(str, others)) for path, others in graph.items()})


def test_rooms_do_not_import_each_other_in_a_circle():
    assert not circle(arrows(modules(), depth=1))


@pytest.mark.parametrize("outer", sorted({room(path).split("/")[0] for path in modules() if "/" in room(path)}))
def test_the_folders_inside_a_room_do_not_import_each_other_in_a_circle(outer: str):
    """A room's own modules are left out: its main module imports its folders, and they what they share."""
    inner = {name: others - {outer} for name, others in arrows(modules(), depth=2).items() if "/" in name}
    assert not circle({name: others for name, others in inner.items() if name.startswith(f"{outer}/")})


def test_no_room_is_too_large_to_be_read():
    files = Counter(room(path) for path in LIBRARY.rglob("*.py") if path.name != "__init__.py")
    assert not {name: count for name, count in files.items() if count > MOST_FILES}
