"""Execute pages: each one in an empty folder, block after block, as a reader would.

    python scripts/tutorials.py check [PAGE…]    # report other output than that of the pages
    python scripts/tutorials.py write [PAGE…]    # write the output into the pages

Without PAGE: all pages of docs that have a block ``console``.

A block ``console`` holds commands after ``$ `` with what they print, both streams. A block
``python`` is executed, in one namespace for the page; what it prints stands in a block ``text``
right behind it. A line or an end of a line ``…`` stands for anything. Times may differ by anything,
the last decimal of a number by one, and more on pages that train a network. The folder has a link
to ``configs``. docs/start.md is docs/quickstart.ipynb, too; there a block ``python`` shows the
overlay of a ``detection`` with which its last line begins.

Commands of roadtorch run in copies of this process, which has imported everything once.
"""

import contextlib
import difflib
import importlib
import io
import os
import re
import runpy
import shlex
import sys
import tempfile
import traceback
import warnings
from argparse import ArgumentParser, RawDescriptionHelpFormatter
from collections.abc import Iterator, Sequence
from multiprocessing import get_context
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # for the package beside

from docs._extensions.notebooks import as_notebook, same_notebook

ROOT = Path(__file__).resolve().parents[1]
ANYTHING = "…"
BLOCK = re.compile(r"^```(console|python|text)\n(.*?)^```$", re.M | re.S)
SPLIT = re.compile(r"([+\-\u2212]?(?:\d+(?:,\d{3})*(?:\.\d+)?|\.\d+))")
TIMES = re.compile(r"^ ?(ms|s|seconds|minutes|MB|kB)\b")
TRAINING = re.compile(r"^\$ roadtorch (train|adapt) ", re.M)
NOTEBOOKS = {ROOT / "docs/start.md": ROOT / "docs/quickstart.ipynb"}
TRAINED_TOLERANCE = 0.03
"""Fraction by which numbers may differ where a network was trained: machines round differently."""


# --- comparing ---------------------------------------------------------------------------


def same(expected: Sequence[str], actual: Sequence[str], tolerance: float = 0) -> bool:
    """Return whether lines are those expected, ``…`` being any lines; numbers as ``near``."""
    if not expected:
        return not actual
    if expected[0].strip() == ANYTHING:
        return any(same(expected[1:], actual[at:], tolerance) for at in range(len(actual) + 1))
    is_equal = bool(actual) and same_line(expected[0], actual[0], tolerance)
    return is_equal and same(expected[1:], actual[1:], tolerance)


def same_line(expected: str, actual: str, tolerance: float = 0) -> bool:
    """Return whether lines are equal up to spaces, times and roundings of numbers."""
    if expected.rstrip().endswith(ANYTHING):
        expected = expected.rstrip().removesuffix(ANYTHING).rstrip()
        actual = " ".join(actual.split()[: len(expected.split())])  # as long as the expected line
    parts, actual_parts = (SPLIT.split(" ".join(line.split())) for line in (expected, actual))
    if parts[0::2] != actual_parts[0::2]:
        return False
    triples = zip(parts[1::2], actual_parts[1::2], parts[2::2], strict=True)
    return all(bool(TIMES.match(unit)) or near(a, b, tolerance) for a, b, unit in triples)


def near(expected: str, actual: str, tolerance: float) -> bool:
    """Return whether a number differs by at most one of its last decimal, or by this fraction."""
    a, b = (float(text.replace(",", "").replace("\u2212", "-")) for text in (expected, actual))
    decimals = len(expected.partition(".")[2])
    step = 10.0**-decimals if decimals else 0.0
    return abs(a - b) <= max(tolerance * abs(a), step) + 1e-12


# --- executing ---------------------------------------------------------------------------


def commands_of(text: str) -> Iterator[tuple[str, list[str]]]:
    """Yield the commands of a console block, each with the lines that follow it.

    A command whose line ends in a backslash goes on in the next one.
    """
    command, output, more = "", [], False
    for line in text.splitlines():
        if more:
            command, more = f"{command}\n{line}", line.endswith("\\")
        elif line.startswith("$ "):
            if command:
                yield command, output
            command, output, more = line[2:], [], line.endswith("\\")
        else:
            output.append(line)
    if command:
        yield command, output


PROGRESS = re.compile(r"roadtorch: ((.* )?\d+ %.* left|.*\d+ \w+s in [\d:]+)")
"""Lines of a long run, which a busy machine makes of any."""


def printed_by(command: str) -> list[str]:
    """Run a command in a copy of this process and return the lines that it prints."""
    with tempfile.TemporaryFile() as output:
        if not (child := os.fork()):
            os.dup2(output.fileno(), 1)
            os.dup2(output.fileno(), 2)
            status = 1
            try:
                status = run(command)
            finally:
                sys.stdout.flush()
                sys.stderr.flush()
                os._exit(status)
        os.waitpid(child, 0)
        output.seek(0)
        lines = output.read().decode().rstrip("\n").splitlines()
    return [line for line in lines if not PROGRESS.fullmatch(line)]


def run(command: str) -> int:
    """Run a command here; those of roadtorch and of its modules without a new interpreter."""
    words = shlex.split(command.replace("\\\n", " "), comments=True)
    simple = not set(command.replace("\\\n", " ")) & set("|>;&`")
    try:
        if simple and words[0] == "roadtorch":
            from roadtorch.cli.group import main

            main(words[1:])
        if simple and words[:2] == ["python", "-m"]:
            sys.argv = words[2:]
            warnings.simplefilter("ignore", RuntimeWarning)  # it is imported already
            runpy.run_module(words[2], run_name="__main__", alter_sys=True)
            return 0
    except SystemExit as stop:
        return stop.code if isinstance(stop.code, int) else 0
    except Exception:
        traceback.print_exc()
        return 1
    os.execvp("bash", ["bash", "-c", command])


def execute_all(pipe: Any) -> None:
    """Execute each block of Python of a pipe; send back what it prints, and its image, if any."""
    names: dict[str, Any] = {"__name__": "tutorial"}
    while True:
        code, output, image = pipe.recv(), io.StringIO(), b""
        with contextlib.redirect_stdout(output):
            try:
                exec(compile(code, "tutorial", "exec"), names)
                if code.splitlines()[-1].startswith("detection "):
                    image = names["detection"]._repr_jpeg_()
            except Exception:
                traceback.print_exc(file=output)
        pipe.send((output.getvalue().rstrip("\n").splitlines(), image))


def console_as_run(text: str, tolerance: float) -> str:
    """Return a console block with what its commands print now."""
    lines = ""
    for command, expected in commands_of(text):
        lines += f"$ {command}\n" + output_as_shown(expected, printed_by(command), tolerance)
    return lines


def output_as_shown(expected: Sequence[str], actual: Sequence[str], tolerance: float) -> str:
    """Return the expected lines where the actual ones are the same, otherwise the actual ones."""
    lines = [line.rstrip() for line in expected]
    while lines and not lines[-1]:
        lines.pop()
    output = expected if same(lines, actual, tolerance) else shortened(lines, actual)
    return "".join(f"{line}\n" for line in output)


def shortened(expected: Sequence[str], actual: Sequence[str]) -> list[str]:
    """Return the actual lines, each ending in ``…`` where the expected line of its word does."""
    ends = [line.removesuffix(ANYTHING).split() for line in expected if line.endswith(ANYTHING)]
    words = {line[0]: len(line) for line in ends if line}
    output = []
    for line in actual:
        first = next(iter(line.split()), "")
        start = re.match(rf"(\s*\S+){{{words.get(first, 0)}}}", line)
        output.append(f"{start[0]}  {ANYTHING}" if start and first in words else line)
    return output


def run_page(page: str, images: list[bytes]) -> str:
    """Return a page with the output that it has now, executed in an empty folder.

    images: gets what each block of Python shows, as JPEG; empty for nothing.
    """
    cwd, context, printed = Path.cwd(), get_context("fork"), list[str]()
    tolerance = TRAINED_TOLERANCE if TRAINING.search(page) else 0.0
    # Not in this process: libraries that have worked have threads, which its copies lack.
    python, child_end = context.Pipe()
    process = context.Process(target=execute_all, args=(child_end,), daemon=True)

    def as_run(block: re.Match[str]) -> str:
        nonlocal printed
        kind, text = block.groups()
        if printed and kind != "text":
            raise ValueError(f"this is printed, and no block `text` has it: {printed}")
        if kind == "python":
            python.send(text)
            printed, image = python.recv()
            images.append(image)
        elif kind == "text":
            text, printed = output_as_shown(text.splitlines(), printed, tolerance), []
        else:
            text = console_as_run(text, tolerance)
        return f"```{kind}\n{text}```"

    with tempfile.TemporaryDirectory() as folder:
        os.symlink(ROOT / "configs", Path(folder, "configs"))
        os.chdir(folder)
        process.start()
        try:
            return BLOCK.sub(as_run, page)
        finally:
            process.kill()
            os.chdir(cwd)


# --- the command ---------------------------------------------------------------------------


def executed_pages() -> Iterator[Path]:
    """Yield the pages of docs that have commands with their output."""
    for path in sorted((ROOT / "docs").rglob("*.md")):
        if "```console\n$ " in path.read_text(encoding="utf-8"):
            yield path


def prepare() -> None:
    """Import what commands need, once for all of them, with one thread."""
    os.environ["OMP_NUM_THREADS"] = "1"
    os.environ["OMP_WAIT_POLICY"] = "passive"
    os.environ["PYTHONPATH"] = str(ROOT)
    os.environ["PATH"] = f"{Path(sys.executable).parent}:{os.environ['PATH']}"
    import torch
    import torch._dynamo  # optimisers import it

    import roadtorch.testing.scenes
    import roadtorch.train.adaptation.adapt  # noqa: F401
    from roadtorch.cli.group import COMMANDS

    for place, _ in COMMANDS.values():
        importlib.import_module(place.partition(":")[0])
    torch.set_num_threads(1)


def main() -> int:
    """Check or write the given pages; return 1 if the output of a page differs."""
    parser = ArgumentParser(description=__doc__, formatter_class=RawDescriptionHelpFormatter)
    parser.add_argument("act", choices=("check", "write"))
    parser.add_argument("pages", nargs="*", type=Path)
    options = parser.parse_args()
    prepare()
    wrong = 0
    for path in options.pages or executed_pages():
        old, begin = path.read_text(encoding="utf-8"), sum(os.times()[:4])
        new = run_page(old, images := [])
        took = sum(os.times()[:4]) - begin  # of the processor, children's too
        print(f"{path.name}: {'as written' if old == new else 'differs'}, {took:.1f} s")
        if old != new:
            wrong += 1
            lines = old.splitlines(), new.splitlines()
            print("\n".join(difflib.unified_diff(*lines, lineterm="")))
            if options.act == "write":
                path.write_text(new, encoding="utf-8")
        if (notebook := NOTEBOOKS.get(path.resolve())) is None:
            continue
        text = as_notebook(new, BLOCK, images)
        if not notebook.exists() or not same_notebook(notebook.read_text(encoding="utf-8"), text):
            wrong += 1
            print(f"{notebook.name}: differs")
            if options.act == "write":
                notebook.write_text(text, encoding="utf-8")
    return 1 if wrong and options.act == "check" else 0


if __name__ == "__main__":
    sys.exit(main())
