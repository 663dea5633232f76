"""``python -m roadtorch.train`` is ``roadtorch train``."""

import sys

from roadtorch.cli import main

if __name__ == "__main__":
    main(["train", *sys.argv[1:]])
