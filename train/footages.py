"""Write the groups of a labelled set as folder sets of their own, to evaluate adaptation.

    python train/footages.py camvid:DATA/camvid --out FOOTAGES
    for one in FOOTAGES/* MANY/* DRIVES/*; do
      run=runs/$(basename $one)
      roadtorch adapt $one/images --threads 1 --out $run
      roadtorch evaluate folder $one --detector $run/weights.safetensors --against fusion --out $run
    done

writes FOOTAGES/GROUP/images, links, and masks (255 road, 0 not, 128 uncertain). Labels only
evaluate. MANY's cameras and rendered drives (train/worlds) have this form already.
"""

import argparse
from pathlib import Path

import torch

from roadtorch.base.atomic import make_folder
from roadtorch.base.image import write_labels
from roadtorch.data.catalogue import open_dataset_spec


def main() -> None:
    """Write the groups."""
    parser = argparse.ArgumentParser(description="Groups of a labelled set as folder sets.")
    parser.add_argument("dataset", help="NAME:ROOT")
    parser.add_argument("--out", type=Path, required=True)
    options = parser.parse_args()
    dataset = open_dataset_spec(options.dataset)
    for item in dataset.items:
        folder = options.out / (item.group or dataset.name)
        for kind in ("images", "masks"):
            make_folder(folder / kind)
        truth = dataset.truth(item)
        mask = torch.where(truth.valid, truth.road * 255, 128).to(torch.uint8)
        name = item.name.replace("/", "-")
        write_labels(folder / "masks" / f"{name}.png", mask)
        link = folder / "images" / f"{name}{item.image.suffix}"
        if not link.exists():
            link.symlink_to(item.image.resolve())


if __name__ == "__main__":
    main()
