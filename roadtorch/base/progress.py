"""How far a long run is: a bar on a terminal, now and then a line where output is piped."""

import sys
from collections.abc import Iterable
from typing import Any

from tqdm import tqdm

LINE_EVERY = 30.0  # seconds between lines where there is no terminal; the first comes after as many


class Progress(tqdm):  # pyright: ignore[reportMissingTypeArgument]
    """tqdm's bar on stderr where that is a terminal; elsewhere a line every half a minute.

    A line has the share that is done and the time left, where the total is known. quiet: neither of
    them. unit: in the singular. Everything else is tqdm's, ``Progress.write`` among it.
    """

    def __init__(
        self, items: Iterable[Any] | None = None, *, quiet: bool = False, unit: str, **options: Any
    ) -> None:
        self._lines = not sys.stderr.isatty()
        if self._lines:
            total = options.get("total") or (len(items) if hasattr(items, "__len__") else None)  # type: ignore[arg-type]
            title = f"{options['desc']}: " if "desc" in options else ""
            share = "{percentage:.0f} % ({n_fmt} of {total_fmt} %ss), {remaining} left"
            line = (share if total else "{n_fmt} %ss in {elapsed}").replace("%s", unit)
            options |= {"bar_format": f"roadtorch: {title}{line}", "leave": False, "miniters": 1}
            options |= {"mininterval": LINE_EVERY, "delay": LINE_EVERY}
        super().__init__(items, unit=unit, disable=quiet, file=sys.stderr, **options)

    def display(self, msg: str | None = None, pos: int | None = None) -> bool:
        """Draw the bar, or write its line."""
        if not self._lines:
            return bool(super().display(msg, pos))
        if msg is None:
            self.fp.write(f"{self}\n")
            self.fp.flush()
        return False

    def clear(self, nolock: bool = False) -> None:
        """Make room for a message; lines stay."""
        if not self._lines:
            super().clear(nolock)

    def refresh(self, nolock: bool = False, lock_args: Any = None) -> Any:
        """Draw the bar again; a line is written when it is due, not after each message."""
        if not (self._lines and nolock):
            return super().refresh(nolock, lock_args)
