"""``python -m roadtorch.train`` is ``roadtorch train``; ``torchrun -m`` needs a module."""

import sys

from roadtorch.cli import main

if __name__ == "__main__":
    main(["train", *sys.argv[1:]])
