"""Good pictures among tampered ones and odd files: a short run of ``scripts/fuzz_folder.py``."""

from pathlib import Path

from scripts import fuzz_folder


def test_forty_of_forty_good_pictures_are_done_and_every_refusal_names_its_file(
    tmp_path: Path,
) -> None:
    names = fuzz_folder.write_folder(tmp_path / "in", good=40, count=60, seed=1)

    night = fuzz_folder.run(tmp_path / "in", tmp_path / "out", names, seconds=300)

    assert night.done == len(night.good) == 40
    assert night.code == 1
    assert not night.unnamed
    assert {"pipe.png", "zero.png", "loop.png", r"z\xff.jpg", "line\nend.png"} <= set(night.others)
    assert len(night.others) >= 60


def test_a_refusal_without_the_name_is_counted() -> None:
    night = fuzz_folder.Night({"g": "failed: g: x"}, {"a b": "failed: b", "c": "done"}, 1)

    assert (night.done, night.unnamed) == (0, ["a b"])
