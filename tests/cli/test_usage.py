"""Wrong usage of every command: one line on stderr, exit code 2, and nothing written."""

from pathlib import Path

import click
import pytest

from roadtorch.cli.group import main
from roadtorch.cli.options import OPTION_CONDITIONS, ConfigFile
from tests.command import Call, bytes_in, save_image

MISTAKES = {
    # Commands and options
    "infr": "infr: no such command (did you mean infer?)",
    "images": "images: no such command (did you mean roadtorch infer images?)",
    "xyz": "xyz: no such command (see roadtorch --help)",
    "finetune": "finetune: no such command (did you mean adapt?)",
    "infer": "Missing argument 'INPUT...' (see roadtorch infer --help)",
    "label x.jpg": "Missing option '--out' (see roadtorch label --help)",
    "detectors x y": "Got unexpected extra argument (y) (see roadtorch detectors --help)",
    "infer x.jpg --detectr x": "--detectr: no such option (did you mean --detector, --every",
    "infer x.jpg --depth 12": "Invalid value for '--depth': '12' is not one of '8', '16'",
    "infer x.jpg --save masks": "masks: unknown kind of result (did you mean mask, mask-video?)",
    "infer x.jpg --save ,": "--save: nothing to save (",
    "infer x.jpg --start 2": "--start, --end: images have no time stamps (",
    "infer x.jpg --device meta": "--device meta: ",
    "infer x.jpg --device gpu": "--device gpu: is no torch device (",
    "infer x.jpg --device cuda:99": "--device cuda:99: ",
    # Detectors and their settings
    "infer x.jpg --detector prior:row": "prior:row: unknown detector (did you mean",
    "infer x.jpg --set treshold=.1": "treshold: unknown setting (did you mean threshold",
    "infer x.jpg --set threshold=high": "threshold: 'high' was given (",
    "infer x.jpg --threshold 1.5": "threshold: 1.5 was given (",
    "infer x.jpg --set threshold": "threshold: is not a setting (",
    "export lbp --out a.onnx": "lbp: cannot be exported (can be exported: fusion, layout:cnn-7)",
    # Inputs and outputs
    "infer bare": "bare: holds no images (",
    "infer none": "none: does not exist (",
    "infer x.jpg x.mask.png --out .": "x.mask.png: is one of the input images (",
    "infer x.jpg x.png": "x.jpg and x.png: both would write ",
    "infer x.jpg --out x.png": "x.png: cannot be created: File exists (",
    "infer x.jpg --out x.png/below": "x.png/below: cannot be created: ",
    "infer x.jpg --out loop": "loop: cannot be created: ",
    # The ground
    "infer x.jpg --out o --save grid": "grid.height: is missing (give --set ",
    "infer x.jpg --out o --save grid --set grid.height=1": "grid: the lens is not spe",
    "infer x.jpg --out o --save grid --set grid.height=-1": "grid.height: -1 was given",
    "infer x.jpg --out o --save grid --set grid.fov=190": "grid.fov: 190 was given",
    "infer x.jpg --out o --save grid --set grid.pitch=95": "grid.pitch: 95 was given",
    "infer x.jpg --out o --save grid --set grid.range=0.1": "grid.range: 0.1 was given",
    "infer x.jpg --out o --save grid --set grid.cells=1": "grid.cells: unknown setting",
    # Learning and correcting
    "train --config xyz --images . --out o": "xyz: unknown config, and no path such as ./NAME.toml",
    "train --config adapt --images . --out o --set teacher.margi=1": (
        "teacher.margi: unknown setting (did you mean teacher.margin"
    ),
    "train --images . --out o": "--config: is missing (give it, or --masks, or --corrections)",
    "train --images . --out o --masks a --corrections b": "--masks: is given with --corrections (",
    "train --images . --out o --masks bare": "bare: lies in --images . (give the folder of the im",
    "train --images *.jpg --out o --masks bare": "bare: has a mask for none of 1 images, such as x",
    "adapt --out o": "Missing argument 'FOOTAGE...'",
    "adapt x.jpg --out o --set kind=patches": "network.height: unknown setting",
    "adapt x.jpg --out o --set initial_weights=": "kind, initial_weights: adaptation",
    "annotate bare --detector prior:rows": "bare: holds no images (",
    "annotate . --export coco": "Missing option '--to'",
    "annotate . --import coco": "Missing option '--from'",
    "annotate . --export xml --to x": "Invalid value for '--export': 'xml' is not one of 'png', 'c",
    "annotate . --report --out nowhere": "nowhere: is not a folder",
    "annotate . --detector prior:rows --out x.jpg": "x.jpg: cannot be created",
}


@pytest.mark.parametrize("line", MISTAKES)
def test_a_mistake_is_one_line_before_any_work(
    line: str, call: Call, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("x.jpg", "x.png", "x.mask.png"):
        save_image(tmp_path / name)
    (tmp_path / "bare").mkdir()
    (tmp_path / "loop").symlink_to("loop")
    files = bytes_in(tmp_path)

    result = call(*line.split())

    assert (result.exit_code, result.stdout) == (2, "")
    assert result.stderr.startswith(f"roadtorch: error: {MISTAKES[line]}")
    assert result.stderr.endswith(")\n")
    assert result.stderr.count("\n") == 1
    assert bytes_in(tmp_path) == files
    assert not (tmp_path / "o").exists()


# --- options without effect ---------------------------------------------------------------

WORKING = {
    "adapt": "x.jpg --out o",
    "annotate": ".",
    "evaluate": "camvid .",
    "export": "fusion --out o",
    "infer": "x.jpg --detector prior:rows",
    "train": "--images . --out o --config cnn7",
}
UNUSED = [
    (command, option, word, part)
    for command, conditions in OPTION_CONDITIONS.items()
    for option, condition in conditions.items()
    for words in condition.replace("without", "|without").replace("with ", "|with ").split("|")[1:]
    for word, *parts in [words.split()]
    for part in parts
]


def give(command: str, option: str) -> list[str]:
    """Return the words of an option, with a value that is allowed where it takes one."""
    name, _, value = option.partition(" ")
    loaded = main.get_command(click.Context(main), command)
    assert loaded is not None
    (parameter,) = [item for item in loaded.params if name in item.opts]
    assert isinstance(parameter, click.Option)
    if parameter.is_flag:
        return [name]
    kind = parameter.type
    default = "a.toml" if isinstance(kind, ConfigFile) else "9"
    default = str(kind.choices[-1]) if isinstance(kind, click.Choice) else default
    return [name, f"{value}=1" if value and name == "--set" else value or default]


@pytest.mark.parametrize(("command", "option", "word", "part"), UNUSED)
def test_an_option_without_effect_is_refused(
    command: str, option: str, word: str, part: str, call: Call, tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    save_image(tmp_path / "x.jpg")
    words = give(command, option) + (give(command, part) if word == "without" else [])
    words += ["--save", "mask"] * (part == "likelihood") + ["--out", "o"] * (part == "--submit")
    words += ["--format", "web"] * (part == "onnx")

    result = call(command, *WORKING[command].split(), *words)

    assert result.exit_code == 2, result.output
    assert result.stderr == f"roadtorch: error: {option}: has no effect (give it {word} {part})\n"
    assert not (tmp_path / "o").exists()
