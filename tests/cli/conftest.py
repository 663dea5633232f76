"""The command line called in this process, on a folder of pictures."""

from tests.command import call, footage

__all__ = ["call", "footage"]
