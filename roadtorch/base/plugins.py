"""What other packages add through entry points; a broken one costs only its own."""

import warnings
from collections.abc import Callable
from importlib.metadata import entry_points

from roadtorch.base.signals import noted_signals


def load_plugins(group: str, problem: str, add: Callable[[str, object], None]) -> None:
    """Load every entry point of a group, sorted by name, and hand it to ``add(name, loaded)``.

    what: what they are called in warnings. Whatever goes wrong in one of them, a package that
    ends the process as it is imported included, becomes a RuntimeWarning that names it. A
    Ctrl-C or SIGTERM just then is none of that, whatever the package makes of it: it is raised.
    """
    for point in sorted(entry_points(group=group), key=lambda point: point.name):
        error: BaseException | None = None
        with noted_signals() as stop:
            try:
                add(point.name, point.load())
            except BaseException as raised:  # SystemExit and KeyboardInterrupt included
                error = raised
        stop.interrupt()
        if error is not None:
            package = point.dist.name if point.dist else point.value
            why = str(error) if isinstance(error, Exception) else "it ends the process"
            told = f"{problem} {point.name!r} of {package} cannot be used: {why}"
            warnings.warn(told, RuntimeWarning, stacklevel=2)
