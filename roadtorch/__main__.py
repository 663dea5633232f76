"""``python -m roadtorch`` is ``roadtorch``."""

from roadtorch.cli import main

if __name__ == "__main__":
    main()
