"""Detectors of other packages through entry points; a broken one becomes a warning."""

import warnings
from collections.abc import Callable
from importlib.metadata import entry_points

from roadtorch.base.signals import record_signals


def load_plugins(group: str, add: Callable[[str, object], None]) -> None:
    """Load every entry point of a group, sorted by name, and call ``add(name, loaded)``.

    Any exception of one of them, SystemExit at import included, becomes a RuntimeWarning that names
    it. Ctrl-C or SIGTERM meanwhile is raised, whatever the package makes of it.
    """
    for point in sorted(entry_points(group=group), key=lambda point: point.name):
        error: BaseException | None = None
        with record_signals() as stop:
            try:
                add(point.name, point.load())
            except BaseException as raised:  # SystemExit and KeyboardInterrupt included
                error = raised
        stop.raise_if_requested()
        if error is not None:
            package = point.dist.name if point.dist else point.value
            cause = str(error) if isinstance(error, Exception) else "it ends the process"
            message = f"detectors {point.name!r} of {package} cannot be used: {cause}"
            warnings.warn(message, RuntimeWarning, stacklevel=2)
