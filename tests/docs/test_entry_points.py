"""Every command that a page, a card or a program's own help names answers ``--help``.

Each runs in a process of its own, forked from an interpreter that has imported what is slow.
Blender's modules, which few machines have, are replaced there by mocks.
"""

import ast
import json
import re
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest

from roadtorch.layout.weights import load_network
from roadtorch.testing.scenes import render_scene, write_image

ROOT = Path(__file__).resolve().parents[2]
PAGES = (
    *("README.md", "CONTRIBUTING.md", "Dockerfile", "../shared/DESIGN.md", "docs/**/*.md"),
    *("train/**/*.md", "train/**/*.py", "scripts/**/*.py", "scripts/*.sh", "ros/**/*.md"),
    *("configs/*.toml", "roadtorch/**/*.py", "roadtorch/**/*.md"),
)
WORD = r"(?: ([a-z][a-z\d-]*)(?![\w./=:]))?"  # such as a subcommand
MODULE = re.compile(rf"python3? -m ((?:roadtorch|train)(?:\.\w+)*){WORD}")
SCRIPT = re.compile(rf"(?:python3?|bash) ((?:scripts|train)/[\w./]*\w){WORD}")
COMMAND = re.compile(r"(?:^|[`\n;&|#] *)()roadtorch ([a-z][a-z-]*)")
CODE = re.compile(r"```.*?```|`[^`\n]+`|^#   .*?$", re.S | re.M)
COMMIT = re.compile(r"\bat [0-9a-f]{7}\b")  # of a command that is no longer in the checkout

SLOW = (
    *("matplotlib.pyplot", "rosbags.highlevel", "scipy.stats", "roadtorch.base.vision"),
    *("roadtorch.evaluation.evaluate", "roadtorch.train.adaptation.adapt"),
)
FORKS = (
    f"SLOW = {SLOW}"
    + """
import importlib, json, os, runpy, sys, traceback
from unittest.mock import MagicMock
for name in SLOW:
    importlib.import_module(name)
sys.modules |= {name: MagicMock() for name in ("bpy", "mathutils", "mathutils.noise")}
root, log = os.getcwd(), sys.argv[1]
for kind, target, *words in json.load(sys.stdin):
    if child := os.fork():
        status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        with open(log) as file:
            print(json.dumps([status, file.read()]))
        continue
    output = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    os.dup2(output, 1), os.dup2(output, 2)
    sys.argv, status = [target, *words], 0
    try:
        if kind == "module":
            sys.path[0] = root
            runpy.run_module(target, run_name="__main__", alter_sys=True)
        elif kind == "script":
            sys.path[0] = os.path.dirname(os.path.abspath(target))
            runpy.run_path(target, run_name="__main__")
        else:
            sys.path[0], (module, function) = os.path.join(root, kind), target.split(":")
            getattr(importlib.import_module(module), function)()
    except SystemExit as end:
        status = end.code or 0
    except BaseException:
        traceback.print_exc()
        status = 1
    sys.stdout.flush()
    os._exit(status if isinstance(status, int) else 1)
"""
)


def commands() -> dict[tuple[str, str], set[str]]:
    """Return the first words that pages name behind commands, by the commands' kind and target."""
    words: dict[tuple[str, str], set[str]] = {}
    for page in (path for pattern in PAGES for path in sorted(ROOT.glob(pattern))):
        text = page.read_text(encoding="utf-8")
        for section in re.split(r"(?m)^(?=#+ )", text) if page.suffix == ".md" else [text]:
            code = "\n".join(CODE.findall(section)) if page.suffix in {".md", ".toml"} else ""
            for kind, pattern in {"module": MODULE, "script": SCRIPT, ".": COMMAND}.items():
                for target, word in pattern.findall(code if kind == "." else section):
                    file = ROOT / (target.replace(".", "/") if kind == "module" else target)
                    is_here = file.exists() or file.with_suffix(".py").is_file()
                    is_past = COMMIT.search(section) is not None
                    if is_here or not is_past:
                        words.setdefault((kind, target), set()).add("" if is_past else word)
    return words


def calls() -> Iterator[tuple[tuple[str, ...], set[str]]]:
    """Yield kind, target and arguments of every Python program, and words that its help names."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    (script,) = project["scripts"].values()
    yield (".", script), set()
    yield ("ros/roadtorch_ros", "roadtorch_ros.road:main"), set()
    for (kind, target), words in commands().items():
        if kind == ".":
            yield from (((kind, script, word), set()) for word in sorted(words - {""}))
        elif not target.endswith(".sh"):
            yield (kind, target), words - {""}


def docstring_of(script: Path) -> str:
    """Return what a script's file states about its arguments, such as what DATA holds."""
    file = script / "__main__.py" if script.is_dir() else script
    return ast.get_docstring(ast.parse(file.read_text(encoding="utf-8"))) or ""


@pytest.mark.skipif(sys.platform == "win32", reason="it has no fork")
def test_every_command_that_a_page_names_answers_help(tmp_path: Path) -> None:
    programs = list(calls())
    lines = json.dumps([[*call, "--help"] for call, _ in programs])
    words = [sys.executable, "-c", FORKS, tmp_path / "log"]

    done = subprocess.run(words, cwd=ROOT, input=lines, capture_output=True, text=True, check=True)

    answers = [json.loads(line) for line in done.stdout.splitlines()]
    for (call, subcommands), (status, text) in zip(programs, answers, strict=True):
        assert (status, "usage: " in text.lower()) == (0, True), (call, text)
        assert call[0] != "script" or docstring_of(ROOT / call[1]) in text, call
        choices = re.findall(r"^  \{(.+)\}", text, re.M)
        assert not choices or subcommands <= set(choices[0].split(",")), (call, text)
    assert len(programs) > 30


def test_the_shell_scripts_that_pages_name_are_sound() -> None:
    scripts = [target for _, target in commands() if target.endswith(".sh")]

    assert len(scripts) > 3
    subprocess.run(["bash", "-n", *scripts], cwd=ROOT, check=True)


def test_the_command_that_the_project_was_asked_for_trains(tmp_path: Path) -> None:
    for seed in range(7):
        write_image(tmp_path / "images" / f"{seed}.png", render_scene(seed, 96, 128))
    words = ["-m", "roadtorch.train", "--config", "configs/cnn7.toml", "--threads", "1"]
    words += ["--images", str(tmp_path / "images"), "--out", str(tmp_path / "out")]

    command = [sys.executable, *words, "--set", "stopping.epochs=1"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)

    assert done.returncode == 0, done.stderr
    assert load_network(tmp_path / "out" / "weights.safetensors")
