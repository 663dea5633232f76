"""Command line: one module a command, without algorithms."""

from roadtorch.cli.group import main

__all__ = ["main"]
