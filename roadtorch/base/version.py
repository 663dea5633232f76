"""Version of roadtorch, for the package, its files and its installation."""

__version__ = "1.0.0"
