"""When kernels are said to be compiled for the first time."""

from __future__ import annotations

import ast
import os
import shutil
from importlib import import_module, invalidate_caches
from pathlib import Path

import pytest

import detangled_cli
from detangled.kernels import is_first_run

SOURCE = """from detangled.kernels import kernel


@kernel
def twice(x):
    return 2.0 * x
"""
NAME = "compiled_for_tests"


def test_a_run_is_the_first_until_the_kernel_is_compiled_here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    source = tmp_path / f"{NAME}.py"
    source.write_text(SOURCE)
    monkeypatch.syspath_prepend(tmp_path)
    invalidate_caches()
    twice = import_module(NAME).twice
    cache = Path(twice.stats.cache_path)
    # Of another copy of detangled that shares the cache.
    other = cache.with_name("other_copy")
    other.mkdir(parents=True, exist_ok=True)
    (other / f"{NAME}.twice-4.py311.nbi").touch()
    first = is_first_run(f"{NAME}.twice")
    shutil.rmtree(other)
    assert first
    assert twice(1.5) == 3.0
    assert not is_first_run(f"{NAME}.twice")
    later = source.stat().st_mtime + 10.0
    os.utime(source, (later, later))
    assert is_first_run(f"{NAME}.twice")


def test_every_kernel_that_verbs_wait_for_is_there() -> None:
    names = [
        node.value
        for path in Path(detangled_cli.__file__).parent.glob("*.py")
        for call in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(call, ast.Call) and getattr(call.func, "id", "") == "announce_first_run"
        for node in ast.walk(call.args[0])
        if isinstance(node, ast.Constant) and "." in str(node.value)
    ]
    assert len(names) > 8
    for name in names:
        module, _, function = name.rpartition(".")
        assert hasattr(getattr(import_module(module), function), "stats"), name
