"""The rules of docs/architecture.md that no single file shows: who may import whom, and what stays pure."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
SERVICE = ROOT / "service"
LONGEST_FILE = 400

# The part of the package -> the parts that it may import; each may import itself, `errors` and `__version__`.
MAY_IMPORT = {
    "errors": set[str](),
    "kernel_cache": set[str](),
    "tracking": set[str](),
    "formats": {"tracking"},
    "traffic": {"formats", "tracking"},
    "simulation": {"formats", "traffic", "tracking"},
    "evaluation": {"simulation", "formats", "traffic", "tracking"},
    "storage": {"formats", "traffic", "tracking"},
    "warmup": {"traffic", "formats", "tracking"},
    "settings": set[str](),
    "telemetry": {"settings"},
    "pipeline": {"storage", "formats", "traffic", "tracking", "settings", "telemetry", "warmup"},
    "api": {"pipeline", "storage", "formats", "traffic", "tracking", "settings", "telemetry"},
    "chaos": {"api", "pipeline", "storage", "formats", "tracking", "settings"},
    "cli": {
        "api", "pipeline", "storage", "formats", "traffic", "tracking", "settings", "telemetry", "simulation",
        "evaluation", "warmup", "chaos",
    },
}  # fmt: skip
FOR_EVERYBODY = {"errors", "__version__"}

PURE = {"tracking", "traffic"}
IMPURE_MODULES = {
    "asyncio", "glob", "httpx", "io", "logging", "multiprocessing", "os", "pathlib", "random", "secrets",
    "shutil", "socket", "sqlalchemy", "sqlite3", "structlog", "subprocess", "tempfile", "threading", "time",
    "urllib", "uuid",
}  # fmt: skip
IMPURE_CALLS = {"open", "input", "exec", "eval"}
IMPURE_ATTRIBUTES = {
    "datetime.now", "datetime.utcnow", "datetime.today", "date.today",
    "np.random", "numpy.random", "np.load", "np.save", "np.savez", "np.fromfile", "np.memmap",
}  # fmt: skip


def part_of(path: Path) -> str:
    """Return the part of the package a file belongs to: its folder under service/, or its own name there."""
    return path.relative_to(SERVICE).parts[0].removesuffix(".py")


def imported_modules(tree: ast.Module) -> Iterator[tuple[int, str]]:
    """Yield line and dotted name of everything that is imported, wherever in the file it stands."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from ((node.lineno, alias.name) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            origin = "." * node.level + (node.module or "")
            yield from ((node.lineno, f"{origin}.{alias.name}") for alias in node.names)


def wrong_imports(part: str, source: str) -> list[str]:
    """Return what a file of `part` imports against the direction of dependence."""
    found = []
    for line, name in imported_modules(ast.parse(source)):
        if name.startswith("."):
            found.append(f"line {line}: relative import {name}")
        elif name == "service" or name.startswith("service."):
            target = name.split(".")[1] if "." in name else "service"
            if target not in MAY_IMPORT[part] | FOR_EVERYBODY | {part}:
                found.append(f"line {line}: {part} may not import {name}")
    return found


def impurities(source: str) -> list[str]:
    """Return the clocks, random numbers and input or output that a file uses."""
    tree = ast.parse(source)
    found = [
        f"line {line}: import of {name}"
        for line, name in imported_modules(tree)
        if name.split(".")[0] in IMPURE_MODULES or name.startswith("numpy.random")
    ]
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in IMPURE_CALLS:
            found.append(f"line {node.lineno}: call of {node.func.id}")
        elif isinstance(node, ast.Attribute):
            name = ast.unparse(node)
            if any(name == bad or name.endswith(f".{bad}") for bad in IMPURE_ATTRIBUTES):
                found.append(f"line {node.lineno}: use of {name}")
    return found


def _calls(node: ast.AST) -> set[str]:
    return {c.func.id for c in ast.walk(node) if isinstance(c, ast.Call) and isinstance(c.func, ast.Name)}


def nested_kernel_parts(source: str) -> list[str]:
    """Return the calls of a kernel's part (`tracking.kernel.part`) from another part: slow to compile."""
    functions = [node for node in ast.parse(source).body if isinstance(node, ast.FunctionDef)]
    of_kernels = {
        one.name: _calls(one) for one in functions if "part" in map(ast.unparse, one.decorator_list)
    }
    return [
        f"{name} calls {', '.join(sorted(calls & of_kernels.keys()))}"
        for name, calls in of_kernels.items()
        if calls & of_kernels.keys()
    ]


def modules(parts: set[str] | None = None) -> list[Path]:
    files = [path for path in sorted(SERVICE.rglob("*.py")) if path != SERVICE / "__init__.py"]
    return [path for path in files if parts is None or part_of(path) in parts]


def test_every_module_belongs_to_a_known_part():
    assert {part_of(path) for path in modules()} <= MAY_IMPORT.keys()


def test_nothing_points_the_other_way():
    found = {str(p.relative_to(ROOT)): wrong_imports(part_of(p), p.read_text()) for p in modules()}

    assert {file: problems for file, problems in found.items() if problems} == {}


def test_the_core_has_no_clock_no_randomness_and_no_files():
    found = {str(p.relative_to(ROOT)): impurities(p.read_text()) for p in modules(PURE)}

    assert {file: problems for file, problems in found.items() if problems} == {}


def test_no_part_of_a_kernel_calls_another():
    found = {str(p.relative_to(ROOT)): nested_kernel_parts(p.read_text()) for p in modules(PURE)}
    assert {file: calls for file, calls in found.items() if calls} == {}


def test_a_part_of_a_kernel_that_calls_another_is_found():
    source = "@part\ndef a(): ...\n@part\ndef b(): a()\n@kernel\ndef c(): b()"
    assert nested_kernel_parts(source) == ["b calls a"]


def test_no_source_file_is_too_long():
    scripts = [p for p in sorted((SERVICE / "dashboard").rglob("*.js")) if "vendor" not in p.parts]
    lengths = {str(p.relative_to(ROOT)): len(p.read_text().splitlines()) for p in modules() + scripts}

    assert {file: lines for file, lines in lengths.items() if lines > LONGEST_FILE} == {}


@pytest.mark.parametrize(
    ("part", "source"),
    [
        ("tracking", "from service.pipeline.fold import step"),
        ("tracking", "import service.formats.sensor"),
        ("tracking", "from service import track"),
        ("tracking", "import service"),
        ("traffic", "def f():\n    from service.storage import rows"),
        ("formats", "from service.traffic import lanes"),
        ("storage", "from service.pipeline.records import Record"),
        ("pipeline", "from service.api.app import create_app"),
        ("api", "from service.simulation import roads"),
        ("errors", "from service.tracking import model"),
        ("api", "from .frames import router"),
    ],
)
def test_an_import_against_the_direction_is_found(part, source):
    assert len(wrong_imports(part, source)) == 1


@pytest.mark.parametrize(
    "source",
    [
        "import time",
        "from time import monotonic",
        "import os.path",
        "from pathlib import Path",
        "import numpy.random",
        "from numpy.random import default_rng",
        "from numpy import random as r",
        "import uuid",
        "import numpy as np\nrng = np.random.default_rng(1)",
        "import datetime\nnow = datetime.datetime.now()",
        "from datetime import datetime\nnow = datetime.now(tz=None)",
        "text = open('frames.jsonl').read()",
    ],
)
def test_an_impurity_in_the_core_is_found(source):
    assert impurities(source)


def test_what_the_rules_allow_passes():
    source = "import numpy\nfrom service import __version__\nfrom service.errors import NotFound\nx = numpy.e"

    assert wrong_imports("tracking", source) == []
    assert impurities(source) == []
