"""The contract of every command: random options and values end in one line, never in a bug.

python -m pytest tests/fuzz/test_commands.py                              # some of each
python -m pytest tests/fuzz/test_commands.py --hypothesis-profile long    # thousands of each
"""

import re
import tempfile
from pathlib import Path

import click
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from roadtorch.annotate import server
from roadtorch.base.errors import InputError
from roadtorch.cli.group import COMMANDS, main
from roadtorch.train import run
from roadtorch.train.adaptation import adapt
from tests.command import Call, save_image
from tests.fuzz.mutations import fuzz_settings

PLAIN_WORDS = """
    x - -- -1 0 1 7 0.5 1e999 nan 1,2 , a=b = . .. [ ** *.png gone gone/ gone/x.png
    threshold=0.5 threshold= mirrored=2 threshold.x=1 ego.mask=image.png kind=images
    image.png ./image.png image.png/ images images/ empty maps loop pair masks.json
    text.txt @text.txt @gone text.toml thresholds/cpf-v2 thresholds/x folder camvid folder:pair
    prior:rows prior:* prior:rows=maps x=maps cpf oneclass:* cnn7 adapt backbone-free
    cpu meta likelihood,mask polygons,json mask-video onnxruntime planes a:b.mcap
"""
ODD_WORDS = ("", " ", "x" * 300, "\udcff.png", "a\nb", "\N{GRINNING FACE}")
WORDS = (*PLAIN_WORDS.split(), *ODD_WORDS)
SKIPPED = {"--view", "--help", "--debug"}
"""Options that serve until they are stopped."""

RAW_ERROR = r"bug in roadtorch|Traceback|\b[A-Z]\w+(Error|Exception): "


def make_inputs(folder: Path) -> None:
    """Write images, a labelled pair, maps and files of other kinds."""
    for name in ("image.png", "images/a.png", "images/sub/b.jpg", "pair/images/a.png"):
        save_image(folder / name)
    for name in ("pair/masks/a.png", "maps/a.png"):
        save_image(folder / name, size=(64, 48))
    np.save(folder / "maps" / "b.npy", np.full((48, 64), np.nan))
    (folder / "empty").mkdir()
    (folder / "loop").symlink_to("loop")
    (folder / "text.txt").write_text("image.png\ngone/\n\n")
    (folder / "text.toml").write_text('detector = "prior:rows"\nthreshold = 0.25\n')
    (folder / "masks.json").write_text("{}")


def draw_words(data: st.DataObject, command: click.Command) -> list[str]:
    """Draw arguments and options of a command, with values that may be of another option."""
    words, value = list[str](), st.sampled_from(WORDS)
    for parameter in command.params:
        name = parameter.opts[0]
        if isinstance(parameter, click.Argument):
            words += data.draw(st.lists(value, max_size=2)) or ["image.png"]
        elif name not in SKIPPED and data.draw(st.integers(0, 9)) < (
            8 if parameter.required else 2
        ):
            flags = [*parameter.opts, *parameter.secondary_opts]
            words.append(data.draw(st.sampled_from(flags)))
            if isinstance(parameter, click.Option) and not parameter.is_flag:
                kind = parameter.type
                choices = [*kind.choices] if isinstance(kind, click.Choice) else []
                words.append(data.draw(st.sampled_from([*choices, *WORDS])))
    names = {parameter.opts[0] for parameter in command.params}
    words += ["--jobs", "1"] * ("--jobs" in names)
    return words + ["--detector", "prior:rows"] * (
        "--detector" in names and data.draw(st.booleans())
    )


@pytest.mark.filterwarnings("default")  # a warning is a line on stderr
@pytest.mark.parametrize("name", sorted({*COMMANDS} - {"doctor", "ros"}))
def test_random_options_end_in_one_line(
    name: str, call: Call, monkeypatch: pytest.MonkeyPatch
) -> None:
    def stop(*_: object, **__: object) -> None:
        raise InputError("images", "would be worked on", "stop here")

    monkeypatch.setattr(run, "train", stop)
    monkeypatch.setattr(adapt, "adapt", stop)
    monkeypatch.setattr(server, "make_page_server", stop)
    command = main.get_command(click.Context(main), name)
    assert command is not None

    @fuzz_settings()
    @given(st.data())
    def check(data: st.DataObject) -> None:
        with tempfile.TemporaryDirectory() as folder, pytest.MonkeyPatch.context() as patch:
            make_inputs(Path(folder, "here"))
            patch.chdir(Path(folder, "here"))
            words = draw_words(data, command)

            result = call(name, *words)

            assert result.exit_code in (0, 1, 2), (words, result.stderr)
            assert not re.search(RAW_ERROR, result.stderr), (words, result.stderr)
            if result.exit_code == 2:
                assert re.search(r"^roadtorch: error: .+\n\Z", result.stderr, re.M), words

    check()
