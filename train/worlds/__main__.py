"""Render path-traced worlds with their truth.

    python -m train.worlds 50000 53000 --out WORLDS       (with bpy 5.0.1; opencv-python-headless)
    python -m train.worlds --list train/worlds.csv --out WORLDS       (the numbers of a list)
    python -m train.worlds 50000 50048 --out WORLDS --sheet sheet.jpg  (what is there, with truth)
    python -m train.worlds --check train/worlds.csv --out WORLDS

The first writes WORLDS/images/NUMBER_KIND_LIGHT.jpg and WORLDS/truth/….png (0 sky, 1 vertical, 2
horizontal without road, 3 road, 4 the own vehicle, 255 void), WORLDS/lenses/….toml of fisheyes, and
a row in WORLDS/worlds.csv: name, kind, light, hash of the truth, version of the code. What is there
is kept; a number gives the same image. Several at a time: ``--every 2 --from 1`` takes every second
number. The last compares a folder with a list and fails where one is missing or differs.

Networks learn from the pack, train/worlds.csv: some of 50000 to 52999 (train.worlds.plans). Of each
ten thousand the last thousand teaches no network.
"""

import argparse
import sys
import time
from pathlib import Path

import cv2

from train.worlds.pack import FOLDERS, append_row, compare_with_list, draw_sheet, read_list


def make_world(number: int, folder: Path) -> str:
    """Render one world into a folder; return its name."""
    from train.worlds.render import render_world  # needs Blender

    name, photo, lens = render_world(number, folder)
    part = folder / f"part{number}.jpg"
    cv2.imwrite(str(part), photo.image, [cv2.IMWRITE_JPEG_QUALITY, photo.quality])
    cv2.imwrite(str(folder / "truth" / f"{name}.png"), photo.truth)
    if lens:
        (folder / "lenses" / f"{name}.toml").write_text(lens)
    append_row(folder, name, photo.truth)
    part.rename(folder / "images" / f"{name}.jpg")  # last, so that an image has its truth
    return name


def check_list(folder: Path, table: Path) -> None:
    """Print what a folder lacks of a list; exit with 1 if something is missing or differs."""
    missing, different = compare_with_list(folder, table)
    for fault, names in (("missing", missing), ("different", different)):
        print(f"{len(names)} {fault}", *names[:20])
    sys.exit(bool(missing or different))


def main() -> None:
    """Render numbers, draw a sheet of them, or compare a folder with a list."""
    parser = argparse.ArgumentParser(description="Render path-traced worlds with their truth.")
    parser.add_argument("first", type=int, nargs="?", default=0)
    parser.add_argument("last", type=int, nargs="?", default=0, help="the number after the last")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--every", type=int, default=1)
    parser.add_argument("--from", type=int, default=0, dest="offset")
    parser.add_argument("--sheet", type=Path)
    parser.add_argument("--list", type=Path, help="of numbers to render: name, …, sha256")
    parser.add_argument("--check", type=Path, help="such a list")
    options = parser.parse_args()
    listed = [int(name.split("_")[0]) for name in read_list(options.list)] if options.list else []
    numbers = [*range(options.first, options.last), *listed][options.offset :: options.every]
    if options.check:
        check_list(options.out, options.check)
    if options.sheet:
        cv2.imwrite(str(options.sheet), draw_sheet(options.out, numbers))
        return
    for name in FOLDERS:
        (options.out / name).mkdir(parents=True, exist_ok=True)
    for number in numbers:
        if not any((options.out / "images").glob(f"{number:05d}_*.jpg")):
            begun = time.monotonic()
            name = make_world(number, options.out)
            print(name, f"{time.monotonic() - begun:.1f} s", flush=True)


if __name__ == "__main__":
    main()
