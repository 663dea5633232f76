"""The command line: one module a command, no algorithm in any of them."""

from roadtorch.cli.group import main

__all__ = ["main"]
