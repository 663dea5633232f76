"""Two to be compared: weights, configs, folders of maps or detectors by name."""

from dataclasses import replace
from pathlib import Path

from roadtorch.detectors.catalogue import list_detectors
from roadtorch.errors import ConfigError
from roadtorch.evaluation.contenders import Contender, maps_from, named_detector
from roadtorch.io.bounded import printable
from roadtorch.layout.patch_network import PatchNetwork
from roadtorch.layout.picture_network import PictureNetwork
from roadtorch.layout.weights import load_network
from roadtorch.runtime.shipped_configs import SUFFIX, THRESHOLDS, config_file
from roadtorch.settings import read_settings_file

BY_NETWORK = {PictureNetwork.kind: "fusion", PatchNetwork.kind: "layout:cnn-7"}
"""The detector that weights alone stand for, by the kind of their network."""


def rival(text: str, letter: str) -> Contender:
    """The contender that a text stands for, called ``LETTER:NAME``.

    text: a weight file, what ``--config`` takes, a folder of likelihood maps, or the name of
    a detector. Raises ConfigError for anything else; WeightsError and InputError for a file that
    cannot be used.
    """
    path = Path(text)
    if path.is_dir():
        return _called(maps_from("", path), letter, path.resolve().name)
    if path.suffix == ".safetensors":
        name, values = BY_NETWORK[load_network(path).kind], {"weights": {"file": text}}
        return _called(named_detector(name, values), letter, _own_name(path))
    if path.suffix == SUFFIX or text.startswith(THRESHOLDS):
        values = read_settings_file(config_file(text))
        name = str(values.pop("detector", "fusion"))
        return _called(named_detector(name, values), letter, _own_name(path))
    if text not in list_detectors() and ("/" in text or path.suffix):
        what = "is no weight file, config, folder of maps or detector"
        raise ConfigError(text, what, "check the name")
    return _called(named_detector(text, {}), letter, text)


def _own_name(path: Path) -> str:
    """A file's name with its folder's: many are called weights."""
    return f"{path.resolve().parent.name}-{path.stem}"


def _called(one: Contender, letter: str, name: str) -> Contender:
    return replace(one, name=f"{letter}:{printable(name)}")
