"""The configs that come with roadtorch, by name: ``adapt``, ``thresholds/cpf``.

They lie in the repository's ``configs/``; ``roadtorch/configs`` links there, so that they are
found beside the package in a checkout and in a wheel alike.
"""

from pathlib import Path

from roadtorch.base.errors import unknown_name

CONFIGS = Path(__file__).parents[1] / "configs"

THRESHOLDS = "thresholds/"
"""What the names of configs for detectors begin with; the others are for training."""

SUFFIX = ".toml"


def shipped_configs() -> list[str]:
    """The names of all, sorted: their paths below ``configs/`` without the suffix."""
    found = CONFIGS.rglob(f"*{SUFFIX}")
    return sorted(path.relative_to(CONFIGS).with_suffix("").as_posix() for path in found)


def config_file(text: str) -> Path:
    """The file that ``--config`` names: one that is there, or else one that is shipped.

    What ends in ``.toml`` is a file in any case. Raises ConfigError, with the known names, for
    a name that is neither.
    """
    path = Path(text)
    if path.suffix == SUFFIX or path.is_file():
        return path
    if text not in shipped_configs():
        raise unknown_name("config, and no file", text, shipped_configs())
    return CONFIGS / f"{text}{SUFFIX}"
