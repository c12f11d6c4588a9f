"""The command line: quick to answer, a line and an exit code for each error, stdout for results alone."""

from __future__ import annotations

import importlib.util
import io
import json
import os
import pkgutil
import signal
import subprocess
import sys
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import click
import numpy as np
import pytest
from click.testing import CliRunner, Result

import detangled
from detangled.errors import DetangledError, ModelError, ReadError, TextureError, WriteError
from detangled.formats import write
from detangled.groom import Attribute, Groom, Scope
from detangled.units import CM_PER_UNIT
from detangled_cli import console
from detangled_cli import main as shell
from detangled_cli.info import as_text, describe

# Verbs of other people come and go while they are written; these must be there.
MUST_EXIST = {"info", "convert"}

HEAVY = ["numpy", "numba", "scipy", "onnxruntime", "trimesh", "tqdm", "torch"]

posix_only = pytest.mark.skipif(sys.platform == "win32", reason="signals and pipes of POSIX")


def exists(verb: str) -> bool:
    return importlib.util.find_spec(shell.VERBS[verb].module) is not None


def run(*arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "detangled_cli.main", *arguments],
        capture_output=True,
        text=True,
        env={**os.environ, **environment},
        timeout=120,
        check=False,
    )


def invoke(*arguments: str) -> Result:
    return CliRunner().invoke(shell.detangled, arguments)


def error_line(result: Result) -> str:
    lines = result.stderr.splitlines()
    assert len(lines) == 1, result.stderr
    assert result.stdout == ""
    assert lines[0].startswith("detangled: error: ")
    return lines[0]


@pytest.fixture
def verb(monkeypatch: pytest.MonkeyPatch) -> Callable[[Callable[[], Any]], None]:
    """Put a verb `act` beside the real ones, that does what the function given here does."""

    def install(action: Callable[[], Any]) -> None:
        @click.command()
        @console.quiet_option
        def command() -> None:
            action()

        monkeypatch.setitem(sys.modules, "act_for_tests", SimpleNamespace(command=command))
        monkeypatch.setitem(shell.VERBS, "act", shell.Verb("act_for_tests", "command", "For tests."))

    return install


def raising(error: BaseException) -> Callable[[], Any]:
    def action() -> None:
        raise error

    return action


# A verb `act` in a process of its own: what {body} does.
PROCESS = """
import sys, types, click
from detangled_cli import main
@click.command()
def command():
{body}
module = types.ModuleType("act_for_tests")
module.command = command
sys.modules["act_for_tests"] = module
main.VERBS["act"] = main.Verb("act_for_tests", "command", "For tests.")
main.detangled.main(["act"])
"""


def start(body: str) -> subprocess.Popen[str]:
    lines = "\n".join("    " + line for line in body.strip().splitlines())
    # Buffered as for a user, whatever the tests themselves run under.
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONUNBUFFERED"}
    return subprocess.Popen(
        [sys.executable, "-c", PROCESS.format(body=lines)],
        env=environment,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


# ---- help


@pytest.mark.parametrize("arguments", [["--help"], ["--version"], []])
def test_help_imports_nothing_heavy(arguments: list[str]) -> None:
    program = f"""
import sys
from detangled_cli.main import detangled
try:
    detangled.main({arguments!r}, prog_name="detangled")
except SystemExit:
    pass
print("LOADED", [name for name in {HEAVY!r} if name in sys.modules])
print("VERBS", [name for name in sys.modules if name in {[v.module for v in shell.VERBS.values()]!r}])
"""
    output = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True).stdout
    assert "LOADED []" in output
    assert "VERBS []" in output


def test_no_module_is_called_as_something_that_the_package_offers() -> None:
    """Once loaded it would stand in its place."""
    modules = {module.name for module in pkgutil.iter_modules(detangled.__path__)}
    assert modules.isdisjoint(detangled.__all__)


def test_help_lists_every_verb() -> None:
    result = invoke("--help")
    assert result.exit_code == 0
    for name, entry in shell.VERBS.items():
        assert any(line.split()[:1] == [name] and entry.short_help in line for line in result.stdout.splitlines())


def test_bare_command_shows_help_and_is_wrong_usage() -> None:
    result = invoke()
    assert result.exit_code == 2
    assert result.stdout == ""
    assert "Usage: detangled" in result.stderr


def test_version() -> None:
    result = run("--version")
    assert (result.returncode, result.stdout, result.stderr) == (0, "detangled 0.1.0\n", "")


@pytest.mark.parametrize("name", shell.VERBS)
def test_every_verb_explains_itself_by_an_example(name: str) -> None:
    if not exists(name) and name not in MUST_EXIST:
        pytest.skip(f"{name} is not written yet")
    result = invoke(name, "--help")
    assert result.exit_code == 0, result.output
    assert f"Usage: detangled {name}" in result.stdout
    assert "Example" in result.stdout
    assert f"\n    detangled {name} " in result.stdout


@pytest.mark.parametrize("name", sorted(MUST_EXIST))
def test_the_list_says_what_the_verb_says(name: str) -> None:
    command = shell.detangled.get_command(click.Context(shell.detangled), name)
    assert command is not None
    assert (command.help or "").splitlines()[0] == shell.VERBS[name].short_help


def test_unit_help_names_every_unit() -> None:
    assert set(console.UNIT_NAMES.replace(",", "").replace(" or", "").split()) == set(CM_PER_UNIT)


def test_help_says_that_a_head_may_be_in_so_many_of_a_unit() -> None:
    shown = CliRunner().invoke(shell.detangled, ["retexture", "--help"]).stdout
    assert "--head-unit U Unit of MESH: mm, cm, dm, m or in, or so many of one, as 2.5mm." in " ".join(shown.split())


# ---- errors


@pytest.mark.parametrize(
    ("error", "code"),
    [
        (DetangledError("no"), 3),
        (ReadError("no"), 3),
        (TextureError("no"), 3),
        (ModelError("no"), 4),
        (WriteError("no"), 5),
    ],
)
def test_each_error_has_its_exit_code(verb: Any, error: DetangledError, code: int) -> None:
    verb(raising(error))
    result = invoke("act")
    assert result.exit_code == code
    assert error_line(result) == "detangled: error: no"


def test_an_error_of_two_lines_is_shown_in_one(verb: Any) -> None:
    verb(raising(ReadError("strand 3 is bad:\n  NaN at point 7")))
    assert error_line(invoke("act")) == "detangled: error: strand 3 is bad: NaN at point 7"


@pytest.mark.parametrize(
    "error",
    [ZeroDivisionError("by zero"), MemoryError(), KeyError("width"), EOFError(), OSError(28, "No space")],
)
def test_a_bug_is_one_line_that_names_the_exception(verb: Any, error: Exception) -> None:
    verb(raising(error))
    result = invoke("act")
    assert result.exit_code == 1
    line = error_line(result)
    assert type(error).__name__ in line
    assert str(error) in line
    assert line.endswith("set DETANGLED_TRACEBACK=1 to see where")


def test_traceback_is_shown_when_asked_for(verb: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("DETANGLED_TRACEBACK", "1")
    verb(raising(ZeroDivisionError("by zero")))
    result = invoke("act")
    assert result.exit_code == 1
    assert "Traceback (most recent call last)" in result.stderr
    assert result.stderr.splitlines()[-1].startswith("detangled: error: ZeroDivisionError: by zero")


@pytest.mark.parametrize("error", [KeyboardInterrupt(), click.Abort()])
def test_interruption_in_a_verb(verb: Any, error: BaseException) -> None:
    verb(raising(error))
    result = invoke("act")
    assert result.exit_code == 130
    assert result.stderr.splitlines()[-1] == "detangled: interrupted; nothing was written"


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--nonsense"], "--nonsense"),
        (["inf"], "Did you mean 'info'?"),
        (["info"], "Missing argument 'IN'"),
        (["info", "--nonsense", "x.abc"], "(see 'detangled info --help')"),
        (["info", "--unit", "parsec", "x.abc"], "mm, cm, dm, m, in"),
    ],
)
def test_wrong_usage(arguments: list[str], said: str) -> None:
    result = invoke(*arguments)
    assert result.exit_code == 2
    assert said in error_line(result)


def test_wrong_usage_in_a_real_process() -> None:
    result = run("info", "--nonsense")
    assert result.returncode == 2
    assert result.stdout == ""
    assert len(result.stderr.splitlines()) == 1


@posix_only
def test_ctrl_c_in_a_real_process() -> None:
    process = start('print("ready", flush=True)\nimport time\ntime.sleep(60)')
    assert process.stdout is not None
    assert process.stdout.readline() == "ready\n"
    process.send_signal(signal.SIGINT)
    _, stderr = process.communicate(timeout=30)
    assert process.returncode == 130
    assert stderr.strip() == "detangled: interrupted; nothing was written"


@posix_only
@pytest.mark.parametrize("count", [10, 100_000], ids=["at the end", "midway"])
def test_a_closed_pipe_is_no_news(count: int) -> None:
    """As of `detangled info groom.abc | head -1`, whether the pipe closes while the verb writes or after."""
    process = start(f"sys.stdin.readline()\nfor i in range({count}):\n    sys.stdout.write(str(i) + chr(10))")
    assert process.stdout is not None
    process.stdout.close()
    process.stdout = None
    _, stderr = process.communicate("go\n", timeout=30)
    assert (process.returncode, stderr) == (141, "")


# ---- notes, warnings, progress


def speak() -> None:
    console.note("a note")
    console.warn("a\nwarning")
    warnings.warn("from\na library", UserWarning, stacklevel=1)
    click.echo("result")


def test_stdout_holds_results_alone(verb: Any) -> None:
    verb(speak)
    result = invoke("act")
    assert result.exit_code == 0
    assert result.stdout == "result\n"
    assert result.stderr.splitlines() == [
        "a note",
        "detangled: warning: a warning",
        "detangled: warning: from a library",
    ]


def test_quiet(verb: Any) -> None:
    verb(speak)
    result = invoke("act", "--quiet")
    assert (result.stdout, result.stderr) == ("result\n", "")
    # One quiet call does not make the next one quiet.
    assert "a note" in invoke("act").stderr


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_progress_bar_waits_and_only_shows_on_a_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    assert console.BAR_DELAY_S == 1.0
    monkeypatch.setattr(console, "BAR_DELAY_S", 0.3)

    def bar(stream: io.StringIO, seconds: float) -> str:
        monkeypatch.setattr(sys, "stderr", stream)
        with console.progress_bar("sampling", 10) as advance:
            for _ in range(10):
                time.sleep(seconds / 10)
                advance.update(1)
        return stream.getvalue()

    assert bar(Terminal(), 0.05) == ""
    assert "sampling" in bar(Terminal(), 1.0)
    assert bar(io.StringIO(), 1.0) == ""


def test_first_run_is_announced_once(verb: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    kernels = SimpleNamespace(is_first_run=lambda _: True)
    monkeypatch.setitem(sys.modules, "detangled.kernels", kernels)

    def twice() -> None:
        console.announce_first_run("detangled.grooming.placing.resample")
        console.announce_first_run("detangled.grooming.placing.resample")

    verb(twice)
    assert invoke("act").stderr.count("compiling kernels") == 1
    assert invoke("act", "-q").stderr == ""
    kernels.is_first_run = lambda _: False
    assert invoke("act").stderr == ""


# ---- info


def three_strands() -> Groom:
    straight = np.array([[0.0, 0.0, z] for z in range(5)])
    return Groom.from_strands(
        [straight, np.array([[np.nan, 0, 0], [1, 0, 0]]), 2.0 * straight[:2], np.zeros((1, 3))],
        attributes={
            "width": Attribute(np.full(10, 0.01, dtype=np.float32), Scope.POINT),
            "object": Attribute(np.arange(4), Scope.STRAND),
        },
        unit_cm=100.0,
        unit_source="size",
        up="z",
        objects=("hair", "brows"),
        notes=("A note.",),
    )


def test_describe_leaves_bad_strands_out_of_the_lengths() -> None:
    facts = describe(three_strands())
    assert (facts["strands"], facts["points"], facts["unusable_strands"]) == (4, 10, 2)
    assert facts["points_per_strand"] == {"min": 1, "median": 2.0, "max": 5}
    assert facts["length_cm"] == {"min": 2.0, "median": 3.0, "max": 4.0}
    assert facts["box_cm"] == {"min": [0, 0, 0], "max": [0, 0, 4]}
    assert (facts["unit"], facts["unit_cm"], facts["unit_source"], facts["up"]) == ("m", 100.0, "size", "z")
    assert facts["attributes"]["width"] == {"scope": "point", "dtype": "float32", "shape": [10]}
    assert facts["notes"] == ["A note."]
    json.dumps(facts, allow_nan=False)


def test_describe_measures_strands_too_long_for_hair_and_counts_them_as_unusable() -> None:
    facts = describe(Groom.from_strands([[[0, 0, 0], [0, 0, -20]], [[0, 0, 0], [0, 0, -3000]]]))
    assert facts["unusable_strands"] == 1
    assert facts["length_cm"] == {"min": 20.0, "median": 1510.0, "max": 3000.0}
    assert "1 (not finite, fewer than two distinct points, or longer than 20 m)" in as_text({"file": "a.abc", **facts})


def test_describe_a_groom_without_strands() -> None:
    facts = describe(Groom.from_strands([]))
    assert facts["length_cm"] is facts["box_cm"] is facts["points_per_strand"] is None
    assert "none to measure" in as_text({"file": "empty.abc", **facts})


def test_as_text_says_it_all() -> None:
    text = as_text({"file": "groom.abc", **describe(three_strands())})
    for said in (
        "groom.abc",
        "guessed from its size",
        "2.00 to 4.00 cm",
        "hair, brows",
        "float32 (10,)",
        "A note.",
    ):
        assert said in text


# ---- with files


@pytest.fixture(params=[".abc", ".npz"])
def groom_file(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    path = tmp_path / f"groom{request.param}"
    rng = np.random.default_rng(1)
    strands = [np.cumsum(rng.normal(0.3, 0.1, (12, 3)), axis=0) for _ in range(5)]
    write(Groom.from_strands(strands, unit_cm=1.0, unit_source="given"), path)
    return path


def test_info_of_a_file(groom_file: Path) -> None:
    result = run("info", str(groom_file), "--unit", "cm", "--json")
    assert (result.returncode, result.stderr) == (0, "")
    facts = json.loads(result.stdout)
    assert (facts["strands"], facts["points"], facts["unit"], facts["unit_source"]) == (5, 60, "cm", "given")
    text = run("info", str(groom_file), "--unit", "cm")
    assert text.returncode == 0
    assert "as given" in text.stdout


def test_convert_a_file(groom_file: Path) -> None:
    out = groom_file.with_stem("out")
    result = run("convert", str(groom_file), str(out), "--unit", "cm", "--out-unit", "m")
    assert result.returncode == 0, result.stderr
    assert result.stdout == ""
    assert f"{out}: 5 strands, 60 points, in m" in result.stderr
    before = json.loads(run("info", str(groom_file), "--unit", "cm", "--json").stdout)
    after = json.loads(run("info", str(out), "--unit", "m", "--json").stdout)
    assert after["length_cm"]["median"] == pytest.approx(before["length_cm"]["median"], rel=1e-5)
    quiet = run("convert", str(groom_file), str(out), "--unit", "cm", "--quiet")
    assert (quiet.returncode, quiet.stdout, quiet.stderr) == (0, "", "")


def test_missing_file(groom_file: Path) -> None:
    missing = groom_file.with_stem("missing")
    for arguments in (["info", str(missing)], ["convert", str(missing), str(groom_file.with_stem("out"))]):
        result = run(*arguments)
        assert result.returncode == 3
        assert len(result.stderr.splitlines()) == 1
        assert str(missing) in result.stderr


def test_a_file_that_is_no_groom(groom_file: Path) -> None:
    for content in (b"", b"not a groom"):
        path = groom_file.with_stem("bad")
        path.write_bytes(content)
        result = run("info", str(path))
        assert result.returncode == 3, result.stderr
        assert len(result.stderr.splitlines()) == 1


def test_unwritable_output(groom_file: Path, tmp_path: Path) -> None:
    blocked = tmp_path / "a file, not a folder"
    blocked.write_text("")
    for target in (blocked / groom_file.name, tmp_path / "no such folder" / groom_file.name):
        result = run("convert", str(groom_file), str(target), "--unit", "cm", "--quiet")
        assert result.returncode == 5, result.stderr
        assert len(result.stderr.splitlines()) == 1
        assert not target.exists()
