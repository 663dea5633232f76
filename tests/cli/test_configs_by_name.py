from pathlib import Path

from tests.command import Call


def test_a_detectors_config_is_found_by_name(call: Call) -> None:
    result = call("infer", "--config", "thresholds/cpf-v2", "--print-config")

    assert result.exit_code == 0, result.stderr
    assert result.stdout.startswith('detector = "cpf:v2"\nthreshold = 0.517\n')


def test_a_training_is_found_by_name(call: Call, tmp_path: Path) -> None:
    """The key is refused by the kind of training that the config names."""
    words = ("--images", tmp_path, "--out", tmp_path / "run", "--set", "teacher.margi=0.1")
    result = call("train", "--config", "adapt", *words)

    assert result.exit_code == 2
    told = "roadtorch: error: teacher.margi: unknown setting (did you mean teacher.margin"
    assert result.stderr.startswith(told)


def test_an_unknown_name_lists_the_known_ones(call: Call, tmp_path: Path) -> None:
    result = call("train", "--config", "xyz", "--images", tmp_path, "--out", tmp_path / "run")

    assert result.exit_code == 2
    told = "roadtorch: error: xyz: unknown config, and no file (known: adapt, cnn7, "
    assert result.stderr.startswith(told)
