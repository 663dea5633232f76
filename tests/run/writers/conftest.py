"""The command line called in this process, and where its results go."""

from tests.command import call, footage
from tests.run.conftest import out

__all__ = ["call", "footage", "out"]
