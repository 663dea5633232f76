"""Generated parts of pages: the reference and the cards of weights.

A line ``{{ KIND WORDS… }}`` alone in a page is replaced by Markdown when the page is read:

- ``{{ commands }}``: every command of the command line, with its ``--help``.
- ``{{ settings MODULE… }}``: every setting of the detectors of modules of roadtorch.detectors.
- ``{{ classifiers }}``: settings of the one-class classifiers; ``{{ training }}``: of training.
- ``{{ measures }}``: the measures of evaluation.
- ``{{ api MODULE… }}``: the docstrings of modules.
- ``{{ public }}``: the names of ``roadtorch.__all__``.
- ``{{ file PATH }}``: a Markdown file of the repository, its heading included.
- ``{{ cards NAME… }}``: the cards of shipped weights, a section each.
- ``{{ browser }}``: a link to the page that finds the road in a browser (scripts/build_site.py).

Links to files of the repository lead to pages of the site; links to other files become plain
names, since a site has no repository beside it.
"""

import importlib
import inspect
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import click
from sphinx.application import Sphinx

from roadtorch.base.settings import Settings
from roadtorch.cli.detectors import setting_rows
from roadtorch.cli.group import COMMANDS

DOCS = Path(__file__).resolve().parents[1]
ROOT = DOCS.parent

PLACEHOLDER = re.compile(r"^\{\{ (\w+)((?: \S+)*) \}\}$", re.M)
LINK = re.compile(r"(!?)\[([^\]]*)\]\((?!https?:|mailto:|#|/)([^)#\s]+)(#[^)\s]*)?\)")
FENCE = re.compile(r"^( *)(`{3,})[^`\n]*\n.*?^\1\2 *$", re.M | re.S)


# --- the command line --------------------------------------------------------------------


def commands(_: Sequence[str]) -> str:
    """Return a section for each command, in the order of ``roadtorch --help``."""
    return "\n".join(line for name in sorted(COMMANDS) for line in command_section(name))


def command_named(name: str) -> click.Command:
    """Return the click command of a name in ``COMMANDS``."""
    module, attribute = COMMANDS[name][0].split(":")
    return getattr(importlib.import_module(module), attribute)


def command_section(name: str) -> Iterator[str]:
    """Yield heading, usage, help text and options of one command."""
    command = command_named(name)
    context = click.Context(command, info_name=f"roadtorch {name}")
    usage = " ".join(command.collect_usage_pieces(context))
    yield from (f"(command-{name})=", f"## `roadtorch {name}`", "", COMMANDS[name][1], "")
    yield from ("```text", f"roadtorch {name} {usage}", "```", "")
    yield from help_text(command)
    for parameter in command.get_params(context):
        record = parameter.get_help_record(context)
        if record and record[1]:
            yield from (f"`{record[0]}`", f": {escaped(record[1])}", "")


def help_text(command: click.Command) -> Iterator[str]:
    """Yield the paragraphs of a command's help; those marked as unwrapped become code."""
    for paragraph in inspect.cleandoc(command.help or "").split("\n\n"):
        if paragraph.startswith("\b"):
            yield from ("```text", paragraph.removeprefix("\b").strip("\n"), "```", "")
        else:
            yield from (escaped(paragraph), "")


def escaped(text: str) -> str:
    """Escape text for Markdown, on one line."""
    return re.sub(r"([\\*_<>|`\[\]{}$~#])", r"\\\1", " ".join(text.split()))


# --- settings ------------------------------------------------------------------------------


def settings(modules: Sequence[str]) -> str:
    """Return a section for each detector of the named modules of roadtorch.detectors."""
    lines: list[str] = []
    for name in modules:
        for entry in importlib.import_module(f"roadtorch.detectors.{name}").ENTRIES:
            lines += [f"(settings-{entry.name.replace(':', '-')})=", f"## `{entry.name}`", ""]
            defaults = entry.make_settings({}).model_dump(mode="json")
            rows = settings_list(entry.settings, defaults=defaults)
            lines += [escaped(entry.summary) + ".", "", *rows]
    return "\n".join(lines)


def classifiers(_: Sequence[str]) -> str:
    """Return the settings that one-class detectors share, and a section for each classifier."""
    from roadtorch.detectors.oneclass import ENTRIES
    from roadtorch.oneclass import CLASSIFIERS

    lines = ["### All of them", "", *settings_list(ENTRIES[0].settings, leave_out="classifier.")]
    for name, classifier in CLASSIFIERS.items():
        lines += [f"### `{name}`", "", escaped(classifier.summary) + ".", ""]
        lines += settings_list(classifier.settings, before="classifier.")
    return "\n".join(lines)


def training(_: Sequence[str]) -> str:
    """Return the settings of all kinds of training."""
    from roadtorch.train.config import ImageTraining, PatchTraining, SelfTraining

    lines: list[str] = []
    for kind in (SelfTraining, ImageTraining, PatchTraining):
        lines += [f'### `kind = "{kind.name}"`', "", *settings_list(kind)]
    return "\n".join(lines)


def measures(_: Sequence[str]) -> str:
    """Return a table of the measures: key and meaning."""
    from roadtorch.evaluation.measures import MEASURES

    rows = [f"| {code(each.key)} | {escaped(each.meaning)} |" for each in MEASURES]
    return "\n".join(["| key | meaning |", "|---|---|", *rows])


def settings_list(
    kind: type[Settings],
    before: str = "",
    leave_out: str = "-",
    defaults: Mapping[str, Any] | None = None,
) -> list[str]:
    """Return a list of the settings of a kind: name, type, default, constraints, meaning.

    before: prefix of the names. leave_out: prefix of names to leave out. defaults: as in
    ``setting_rows``.
    """
    lines: list[str] = []
    rows = setting_rows(kind.model_json_schema(), defaults=defaults)
    for key, of_type, default, allowed, meaning in rows:
        if not key.startswith(leave_out):
            shown = f"default {code(default)}" if default else "no default"
            facts = ", ".join(filter(None, (escaped(of_type), shown, escaped(allowed))))
            lines += [
                f"{code(before + key)} {facts}",
                f": {escaped(meaning) or '(a group of its own)'}",
                "",
            ]
    return lines


def code(text: str) -> str:
    """Mark text up as code."""
    return f"`{text}`"


# --- Python --------------------------------------------------------------------------------


def api(modules: Sequence[str]) -> str:
    """Return the docstrings of modules, a section for each."""
    lines: list[str] = []
    for name in modules:
        lines += [f"## `{name}`", "", "```{eval-rst}", f".. automodule:: {name}", "```", ""]
    return "\n".join(lines)


def public(_: Sequence[str]) -> str:
    """Return a table of the public names, linked to their documentation."""
    import roadtorch

    lines = ["| name | |", "|---|---|"]
    for name in roadtorch.__all__:
        if not name.startswith("__"):
            member = getattr(roadtorch, name)
            first = (member.__doc__ or "").strip().split("\n\n")[0]
            link = f"{{py:obj}}`{name} <{member.__module__}.{member.__qualname__}>`"
            lines.append(f"| {link} | {escaped(first)} |")
    return "\n".join(lines)


# --- files ---------------------------------------------------------------------------------


def repository_file(words: Sequence[str]) -> str:
    """Return a Markdown file of the repository with links as of the site."""
    path = ROOT / words[0]
    return linked(path.read_text(encoding="utf-8"), path.parent)


def cards(names: Sequence[str]) -> str:
    """Return the cards of weights, their headings one level lower."""
    texts = {name: repository_file([f"roadtorch/weights/{name}.md"]) for name in names}
    return "\n\n".join(
        f"(weights-{name})=\n{re.sub('^#', '##', text, flags=re.M)}" for name, text in texts.items()
    )


def browser(_: Sequence[str]) -> str:
    """Return a link to the page for browsers, which scripts/build_site.py adds to the site."""
    return '<a href="browser/index.html">Open the page</a>.'


CARDS = ("backbone-free", "scratch-free", "cnn-7", "cnn-7-paper")

PAGES = {
    "CONTRIBUTING.md": "/contributing.md",
    "CHANGELOG.md": "/changelog.md",
    **{f"roadtorch/weights/{name}.md": f"/reference/index.md#weights-{name}" for name in CARDS},
}
"""Files outside of docs/ that are pages, or sections of pages, of the site."""


def linked(text: str, folder: Path) -> str:
    """Make the relative links of text in a folder lead to pages of the site."""

    def changed(match: re.Match[str]) -> str:
        image, words, target, anchor = match.groups(default="")
        path = (folder / target).resolve()
        inside = path.relative_to(ROOT).as_posix() if path.is_relative_to(ROOT) else ""
        if words.endswith(".md") and target.endswith(words.rpartition("/")[2]):
            words = ""  # the title of the page, not its file
        if inside in PAGES:
            return f"[{words}]({PAGES[inside]}{anchor})"
        if inside.startswith("docs/"):
            return f"{image}[{words}](/{inside.removeprefix('docs/')}{anchor})"
        return f"{words} (`{inside}`)" if path.exists() and inside else match[0]

    return outside_fences(text, lambda part: LINK.sub(changed, part))


def outside_fences(text: str, change: Callable[[str], str]) -> str:
    """Change text everywhere but in blocks of code."""
    parts, end = [], 0
    for block in FENCE.finditer(text):
        parts += [change(text[end : block.start()]), block[0]]
        end = block.end()
    return "".join([*parts, change(text[end:])])


# --- Sphinx --------------------------------------------------------------------------------

KINDS: dict[str, Callable[[Sequence[str]], str]] = {
    "commands": commands,
    "settings": settings,
    "classifiers": classifiers,
    "training": training,
    "measures": measures,
    "api": api,
    "public": public,
    "file": repository_file,
    "cards": cards,
    "browser": browser,
}


def filled(text: str) -> str:
    """Replace the placeholders of a page."""
    return PLACEHOLDER.sub(lambda match: KINDS[match[1]](match[2].split()), text)


def fill_page(app: Sphinx, docname: str, source: list[str]) -> None:
    """Fill a page before it is parsed (event ``source-read``)."""
    path = Path(app.env.doc2path(docname))
    source[0] = filled(linked(source[0], path.parent))


def setup(app: Sphinx) -> dict[str, bool]:
    """Connect to the event."""
    app.connect("source-read", fill_page)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
