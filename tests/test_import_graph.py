"""The rooms of the package and the arrows between them, read from the source.

Every import counts, wherever it stands: in a function and under TYPE_CHECKING too. What is still
to be put right stands in `KNOWN`; a test fails as soon as one of these entries is out of date.
"""

from __future__ import annotations

import ast
import os
import subprocess
import sys
from collections import deque
from collections.abc import Iterable, Iterator, Mapping
from functools import cache
from pathlib import Path

import imucald
from paths import ROOT

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
    "api": {"commands", "fleet", "service", "uds"},
    "attitude": IO_ROOMS,
    "config_check": {"api", "commands"},
    "diagnosis": {"api", "commands"},
    "discovery": {"api", "commands", "service", "uds"},
    "drive": IO_ROOMS | {"diagnosis", "mount"},
    "feeds": {"api", "commands", "diagnosis", "uds"},
    "fleet": {"commands", "service", "uds"},
    "model_compensation": {"commands", "runtime", "service"},
    "motion": IO_ROOMS,
    "mount": IO_ROOMS,
    "runtime": {"api", "commands", "feeds", "service"},
    "service": {"api", "commands", "feeds"},
    "simulation": IO_ROOMS,
    "travel_direction": IO_ROOMS,
    "uds": {"runtime", "service"},
}
"""Rooms that never reach these rooms, directly or through others."""

WORKBENCH = {
    "api", "config_check", "diagnosis", "discovery", "fleet", "report", "simulation", "traffic",
}  # fmt: skip
"""The wing that no car needs; `commands` leads into both wings."""
VEHICLE = {
    "attitude", "can", "config", "core", "drive", "feeds", "inputs", "model", "model_compensation",
    "motion", "mount", "runtime", "service", "travel_direction", "uds",
}  # fmt: skip
"""The wing that runs in a car."""
MOST_MODULES = 180
"""Modules of the package in a daemon that has started again (its databases are kept)."""

DIAGNOSIS_ROOMS: Mapping[str, set[str]] = {
    "equations": set(),
    "fit": {"equations"},
    "search": {"equations", "fit"},
    "direct": {"equations", "fit"},
    "left_over": {"equations", "fit", "search", "direct"},
}
"""Rooms of the diagnosis, and those of its others that each imports."""

LAZY_LIBRARIES = {
    "aiohttp", "asammdf", "can", "difflib", "dpkt", "foxglove", "isotp", "jinja2", "kuksa_client",
    "matplotlib", "paho", "rich", "scipy", "subprocess", "threadpoolctl", "yaml", "zstandard",
    "bz2", "glob", "gzip", "lzma", "pkgutil", "tempfile",
}  # fmt: skip
"""Large libraries, which a function may import when it needs them, and in the last line what makes
5 ms together, without which a plain log can be read."""

LAZY_ROOMS = {"commands"}
"""A command loads what it needs when it runs: `--help` and other commands do without."""

LAZY_MODULES: Mapping[str, str] = {
    "__main__.main: cli": "Ctrl-C during its imports is one line",
    "api.drive._repr_html_: api.html": "2 ms: pages of notebooks",
    "api.drive.plot: api.plots": "1 ms: few draw",
    "api.drive.write: api.files.written": "2 ms: few write tables",
    "api.streaming.write: api.files.written": "2 ms: few write tables",
    "api.table_access.arrow: api.files.table_file": "with the next",
    "api.table_access.arrow: api.interchange": "1 ms: the command line asks for no table",
    "api.table_access.resample: api.interchange": "with the one before",
    "api.table_access.resample: api.resampling": "with it",
    "api.table_access.to_pandas: api.interchange": "with it",
    "api.table_access.to_polars: api.interchange": "with it",
    "cli.__call__: core.compiled": "loads numpy: only `--version` asks",
    "can.dbc.database._parsed: can.dbc.bounded_parser": "a kept database needs no parser",
    "can.link.port.open_port: can.link.adapter": "python-can: SocketCAN does without",
    "can.logs.python_can_logs._open: can.python_can": "python-can: candump does without",
    "config.root.json_schema: config.schema": "only `imucald schema` needs it",
    "core.yaml_lines.read_yaml: core.yaml_parser": "10 ms, 0.9 MiB: a kept file needs no parser",
    "fleet.evaluation._replayed: fleet.signals": "loads pyarrow, for corrected signals only",
    "fleet.page._drawing: fleet.pictures": "loads matplotlib",
    "inputs.wiring._raw_route: inputs.expression": "0.2 ms: few have a raw source",
    "report.page._breakable: markupsafe": "comes with jinja2, an extra",
    "report.page._pictures: report.plots": "loads matplotlib",
    "report.replay_page.replay_page: report.replay_plots": "loads matplotlib",
    "runtime.estimators.estimator_for: mount.restored": "1 ms: few state a mount",
    "runtime.estimators.known_mount: mount.restored": "with it",
    "runtime.estimators.learning_estimator: mount.method_a.estimator": "4 ms, 0.4 MiB: few use it",
    "runtime.output.output_frames.__init__: runtime.output.attitude_frames": "1 ms",
    "runtime.output.output_frames.__init__: runtime.output.travel_frames": "4 ms, 0.3 MiB",
    "runtime.session._consumers: runtime.consumers": "7 ms, 0.6 MiB: few switch one on",
    "runtime.session.open_compensation: model_compensation": "11 ms, 3.9 MiB: few have one",
    "runtime.estimators.published_settings: mount.method_a.settings": "with it",
    "service.status._metrics: service.metrics": "1 ms: few ask for metrics",
    "service.parts._new_diagnostics: service.uds_on_bus": "16 ms, 4.9 MiB: few have UDS",
    "service.parts._new_diagnostics: service.uds_records": "with it",
}
"""Modules of ours that a function may import, with what a start without them saves: the daemon is
ready within 0.3 s and takes less than 50 MiB, with those parts only that its configuration uses.
(CPU time and memory beside the rest of the daemon, byte code kept, best of six.)"""

MIN_BODY_LINES = 6
"""A function body of so many lines must not stand twice."""

BARE_NAMES, MOST_CLASSES = ("add", "of", "step", "take"), 8
"""Method names that do not say what a method adds or takes, and in how many classes each may stand:
`step(tick)` is the name of every estimator, `take(index)` is numpy's."""

KNOWN: Mapping[str, set[str]] = {
    "room": set(),
    "circle": set(),
    "class": set(),
    "function": set(),
    "import in a function": set(),
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


def imported(tree: ast.AST) -> Iterator[str]:
    """Full names of the modules that a tree imports."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            for alias in node.names:
                yield alias.name
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"a relative import of {node.module}: write it in full"
            for alias in node.names:
                inner = f"{node.module}.{alias.name}"
                yield inner if ours(inner) else node.module or ""


def ours(name: str) -> str | None:
    """The name of a module of this package without the package's; None for any other."""
    bare = name.removeprefix(f"{NAME}.")
    return bare if bare in modules() and name in (NAME, f"{NAME}.{bare}") else None


@cache
def arrows() -> dict[str, list[str]]:
    """Which module imports which, within the package."""
    return {
        name: sorted({to for to in map(ours, imported(tree)) if to} - {name, NAME})
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


def test_what_runs_in_a_car_imports_nothing_of_the_workbench():
    rooms = {room(name) for name in modules() if "." in name} - {"commands"}
    assert rooms == VEHICLE | WORKBENCH, "name the wing of a new room"
    found = {
        f"{name} -> {to}"
        for name, targets in arrows().items()
        for to in targets
        if room(name) in VEHICLE and room(to) in WORKBENCH
    }
    hold("room", found, "what runs in a car imports a part of the workbench:")


def test_the_daemon_loads_the_wing_of_the_car_only(tmp_path):
    code = (
        "import sys\n"
        "from imucald.cli import main\n"
        "status = main(sys.argv[1:])\n"
        f"print(status, *(m for m in sys.modules if m.split('.')[0] in ('{NAME}', 'scipy')))"
    )
    options = ["--seconds", "0.1", "--interface", "virtual", "--channel", "wings", "--quiet"]
    options += [
        "--config",
        str(ROOT / "config" / "examples" / "passenger_car.yaml"),
        "--status-socket",
        str(tmp_path / "status"),
    ]
    options += ["--state-dir", str(tmp_path)]
    environment = os.environ | {"CACHE_DIRECTORY": str(tmp_path / "cache")}
    for _ in "first", "again":
        process = subprocess.run(
            [sys.executable, "-c", code, "run", *options],
            capture_output=True, text=True, check=False, env=environment,
        )  # fmt: skip
        assert process.returncode == 0, process.stderr
    status, *loaded = process.stdout.splitlines()[-1].split()
    rooms = {name.split(".")[1] for name in loaded if name.startswith(f"{NAME}.")}
    assert status == "0"
    assert not rooms & WORKBENCH
    assert not [name for name in loaded if name.startswith("scipy")]
    assert len(loaded) <= MOST_MODULES, f"{len(loaded)} modules"


def test_rooms_of_the_diagnosis_call_one_way():
    rooms = {
        part[1] for name in modules() if len(part := name.split(".")) > 2 and part[0] == "diagnosis"
    }
    assert rooms == set(DIAGNOSIS_ROOMS)
    found = {
        f"{name} -> {to}"
        for own, allowed in DIAGNOSIS_ROOMS.items()
        for name in modules()
        if name.startswith(f"diagnosis.{own}.")
        for to in arrows()[name]
        if to.split(".")[1:2]
        and to.split(".")[1] in rooms - allowed - {own}
        and room(to) == "diagnosis"
    }
    hold("room", found, "an import leaves its room of the diagnosis in the wrong direction:")


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


def test_few_classes_have_a_method_whose_name_says_too_little():
    places: dict[str, list[str]] = {name: [] for name in BARE_NAMES}
    for name, tree in modules().items():
        for node in ast.walk(tree):
            if isinstance(node, ast.ClassDef):
                for function in node.body:
                    if isinstance(function, ast.FunctionDef) and function.name in places:
                        places[function.name].append(f"{name}.{node.name}")
    many = {bare: classes for bare, classes in places.items() if len(classes) > MOST_CLASSES}
    assert not many, f"say in the name what the method adds or takes: {many}"


def test_functions_import_only_large_libraries():
    found = set()
    for name, tree in modules().items():
        if room(name) in LAZY_ROOMS:
            continue
        for function in functions(tree):
            for to in imported(function):
                if room(to) not in LAZY_LIBRARIES:
                    found.add(f"{name}.{function.name}: {ours(to) or to}")
    gone = sorted(set(LAZY_MODULES) - found)
    assert not gone, f"no function imports this any more; take it out of LAZY_MODULES: {gone}"
    found -= set(LAZY_MODULES)
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
    assert sorted(imported(ast.parse(text))) == ["a.b", "c", f"{NAME}.core.errors"]
    assert (ours("can"), ours(f"{NAME}.can"), ours(f"{NAME}.no")) == (None, "can", None)
    assert "core.errors" in arrows()["can.dbc.database"]
    assert len(modules()) > 100
