"""What other packages add through entry points; a broken one costs only its own."""

import warnings
from collections.abc import Callable
from importlib.metadata import entry_points


def load_plugins(group: str, what: str, add: Callable[[str, object], None]) -> None:
    """Load every entry point of a group, sorted by name, and hand it to ``add(name, loaded)``.

    what: what they are called in warnings. Whatever goes wrong in one of them, a package that
    ends the process as it is imported included, becomes a RuntimeWarning that names it. A
    Ctrl-C just then counts as the package's own.
    """
    for point in sorted(entry_points(group=group), key=lambda point: point.name):
        try:
            add(point.name, point.load())
        except BaseException as problem:  # SystemExit and KeyboardInterrupt included
            package = point.dist.name if point.dist else point.value
            told = str(problem) if isinstance(problem, Exception) else "it ends the process"
            message = f"{what} {point.name!r} of {package} cannot be used: {told}"
            warnings.warn(message, RuntimeWarning, stacklevel=2)
