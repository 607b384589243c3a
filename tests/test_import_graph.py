"""The rooms of the package and the arrows between them, read from the source.

Every import counts, wherever it stands: in a function and under TYPE_CHECKING too. What is still
to be put right stands in `KNOWN`; a test fails as soon as one of these entries is out of date.
"""

from __future__ import annotations

import ast
import subprocess
import sys
from collections import deque
from collections.abc import Iterable, Iterator, Mapping
from functools import cache
from pathlib import Path

import imucald

PACKAGE = Path(imucald.__file__).parent
NAME = PACKAGE.name

ONLY = {
    "core": {"core"},
    "can": {"can", "core"},
    "config": {"config", "core"},
    "inputs": {"inputs", "can", "config", "core"},
}
"""Rooms that import these rooms and no other."""

IO_ROOMS = {"can", "commands", "inputs", "runtime", "service", "uds"}
NEVER = {
    "attitude": IO_ROOMS,
    "diagnosis": {"commands"},
    "motion": IO_ROOMS,
    "mount": IO_ROOMS,
    "runtime": {"commands", "service"},
    "simulation": IO_ROOMS,
    "travel_direction": IO_ROOMS,
    "uds": {"runtime", "service"},
}
"""Rooms that never reach these rooms, directly or through others."""

LAZY_LIBRARIES = {"asammdf", "can", "isotp", "jinja2", "matplotlib", "rich", "scipy", "yaml"}
"""Large libraries, which a function may import when it needs them."""

LAZY_ROOMS = {"commands"}
"""A command loads what it needs when it runs: `--help` and other commands do without."""

MIN_BODY_LINES = 6
"""A function body of so many lines must not stand twice."""

KNOWN: Mapping[str, set[str]] = {
    "room": {
        "config.attitude -> attitude.settings",
        "config.attitude -> travel_direction.settings",
        "config.calibration -> mount.estimator_settings",
        "config.calibration -> mount.method_a.settings",
    },
    "circle": {
        "diagnosis.bent <-> diagnosis.contest <-> diagnosis.search <-> diagnosis.shifts",
    },
    "class": {
        "Attitude: config.attitude, simulation.road",
        "Bus: config.network, model.sensors",
        "Checksum: can.e2e.crc, config.network",
        "Compensation: compensation.compensation, config.attitude",
        "Cycle: diagnosis.faults.cycle, travel_direction.cycles",
        "Database: can.dbc.database, config.network",
        "Handling: diagnosis.handling, simulation.single_track",
        "Message: can.dbc.database, model.sensors",
        "Model: config.base, model.model",
        "MountShift: diagnosis.causes.mount_shift, model.vehicle",
        "RoadGrade: attitude.grade, diagnosis.causes.road_grade",
        "Source: check.source, config.signals",
        "TravelDirection: config.attitude, travel_direction.direction",
        "Triad: config.signals, model.sensors",
    },
    "function": set(),
    "import in a function": {
        "can.dbc.database._nearest: difflib",
        "can.logs.candump_writer._open: gzip",
        "config.root.json_schema: config.schema",
        "core.typed.typed: core.explain",
        "core.yaml_lines.read_yaml: core.yaml_parser",
        "report.page._breakable: markupsafe",
        "report.page._pictures: report.plots",
        "runtime.estimators.estimator_for: mount.estimator",
        "runtime.estimators.estimator_for: mount.method_a.estimator",
        "runtime.output.output_frames._attitude_frames: runtime.output.attitude_frames",
        "runtime.output.output_frames._travel_frames: runtime.output.travel_frames",
        "runtime.session._companions: runtime.consumers",
        "runtime.session.open_compensation: compensation",
        "service.service._new_uds: service.bus_uds",
    },
}
"""What is still to be put right, by rule, as the test words it. Empty is the aim."""


@cache
def modules() -> dict[str, ast.Module]:
    """Every module of the package, by its name without the package's own."""
    found = {}
    for path in sorted(PACKAGE.rglob("*.py")):
        parts = path.relative_to(PACKAGE).with_suffix("").parts
        name = ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
        found[name or NAME] = ast.parse(path.read_text(encoding="utf-8"), str(path))
    return found


def imported(tree: ast.AST) -> Iterator[tuple[str, ast.stmt]]:
    """Names of the modules that a tree imports, ours without the package's name."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            for alias in node.names:
                yield _bare(alias.name), node
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"a relative import of {node.module}: write it in full"
            for alias in node.names:
                inner = _bare(f"{node.module}.{alias.name}")
                yield inner if inner in modules() else _bare(node.module or ""), node


def _bare(name: str) -> str:
    return name.removeprefix(f"{NAME}.")


@cache
def arrows() -> dict[str, list[str]]:
    """Which module imports which, within the package."""
    return {
        name: sorted({to for to, _ in imported(tree) if to in modules() and to not in (name, NAME)})
        for name, tree in modules().items()
    }


def room(module: str) -> str:
    """The room that a module stands in."""
    return module.partition(".")[0]


def way_into(start: str, forbidden: set[str]) -> list[list[str]]:
    """Shortest way from a module to each module of forbidden rooms, not going on from there."""
    ways = {start: [start]}
    queue, found = deque([start]), []
    while queue:
        here = queue.popleft()
        for to in arrows()[here]:
            if to not in ways:
                ways[to] = [*ways[here], to]
                if room(to) in forbidden:
                    found.append(ways[to])
                else:
                    queue.append(to)
    return found


def circles() -> list[list[str]]:
    """Sets of modules of which each reaches every other."""
    reach = {name: {way[-1] for way in _ways(name)} for name in modules()}
    found, seen = [], set[str]()
    for name in modules():
        if name not in seen and name in reach[name]:
            circle = sorted(m for m in reach[name] if name in reach[m])
            seen.update(circle)
            found.append(circle)
    return found


def _ways(start: str) -> Iterator[list[str]]:
    seen, queue = set[str](), deque([start])
    while queue:
        for to in arrows()[queue.popleft()]:
            if to not in seen:
                seen.add(to)
                queue.append(to)
                yield [start, to]


def functions(tree: ast.AST) -> Iterator[ast.FunctionDef | ast.AsyncFunctionDef]:
    """All functions and methods of a tree."""
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            yield node


def hold(rule: str, found: Iterable[str], remedy: str) -> None:
    """Fail on what breaks a rule, and on known breaches that are none any more."""
    now = set(found)
    fresh, stale = sorted(now - KNOWN[rule]), sorted(KNOWN[rule] - now)
    assert not fresh, f"{remedy}\n  " + "\n  ".join(fresh)
    assert not stale, f"put right; take out of KNOWN[{rule!r}]:\n  " + "\n  ".join(stale)


def test_rooms_reach_only_the_rooms_they_may():
    found = set()
    for name, targets in arrows().items():
        allowed = ONLY.get(room(name))
        if allowed is not None:
            found |= {f"{name} -> {to}" for to in targets if room(to) not in allowed}
        for way in way_into(name, NEVER.get(room(name), set())):
            found.add(f"{room(name)}: {way[-2]} -> {way[-1]}")
    hold("room", found, "an import leaves its room in a direction that is not allowed:")


def test_no_modules_import_each_other_in_a_circle():
    hold(
        "circle",
        (" <-> ".join(circle) for circle in circles()),
        "modules import each other in a circle; move what they share down, or use a Protocol:",
    )


def test_no_class_name_stands_twice():
    places: dict[str, list[str]] = {}
    for name, tree in modules().items():
        for node in ast.walk(tree):
            if isinstance(node, ast.ClassDef):
                places.setdefault(node.name, []).append(name)
    twice = (f"{c}: {', '.join(sorted(m))}" for c, m in places.items() if len(m) > 1)
    hold("class", twice, "a class name stands twice; give each class a name of its own:")


def test_no_function_body_stands_twice():
    places: dict[str, list[str]] = {}
    for name, tree in modules().items():
        for function in functions(tree):
            body = function.body[ast.get_docstring(function) is not None :]
            if body and (body[-1].end_lineno or 0) - body[0].lineno + 1 >= MIN_BODY_LINES:
                key = ast.dump(ast.Module(body, []))
                places.setdefault(key, []).append(f"{name}.{function.name}")
    twice = (", ".join(sorted(found)) for found in places.values() if len(found) > 1)
    hold("function", twice, "a function's body stands twice; write it once and import it:")


def test_functions_import_only_large_libraries():
    found = set()
    for name, tree in modules().items():
        if room(name) in LAZY_ROOMS:
            continue
        for function in functions(tree):
            for to, _ in imported(function):
                if room(to) not in LAZY_LIBRARIES:
                    found.add(f"{name}.{function.name}: {to}")
    hold(
        "import in a function",
        found,
        "an import inside a function hides an arrow; put it at the top of its module:",
    )


def test_the_can_library_loads_no_calibration():
    names = [f"{NAME}.{m}" for m in modules() if room(m) in ("can", "core")]
    code = (
        "import importlib, sys\n"
        f"for name in {names!r}: importlib.import_module(name)\n"
        f"print(*sorted({{m.split('.')[1] for m in sys.modules if m.startswith('{NAME}.')}}))"
    )
    process = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False
    )
    assert process.returncode == 0, process.stderr
    assert process.stdout.split() == ["can", "core"]


def test_the_graph_is_read_from_the_source():
    """The test itself: it sees plain, lazy and type-checking imports, and circles."""
    text = "import a.b\ndef f():\n    from imucald.core import errors\nif T:\n    from c import d\n"
    assert sorted(name for name, _ in imported(ast.parse(text))) == ["a.b", "c", "core.errors"]
    assert "core.errors" in arrows()["can.dbc.database"]
    assert len(modules()) > 100
