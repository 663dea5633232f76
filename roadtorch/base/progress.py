"""Progress of a long run: a bar on a terminal, occasional lines where output is piped."""

import sys
from collections.abc import Iterable
from typing import Any

from tqdm import tqdm

LINE_INTERVAL = 30.0  # seconds before the first line and between lines, without a terminal


class Progress(tqdm):  # pyright: ignore[reportMissingTypeArgument]
    """A bar of tqdm on stderr if that is a terminal, otherwise a line every half minute.

    A line has the fraction done and the time left, if the total is known. quiet: neither bar nor
    lines. unit: in the singular; empty to print no counts. The rest is tqdm's, such as ``write``.
    """

    def __init__(
        self, items: Iterable[Any] | None = None, *, quiet: bool = False, unit: str, **options: Any
    ) -> None:
        self._lines = not sys.stderr.isatty()
        if self._lines:
            total = options.get("total") or (len(items) if hasattr(items, "__len__") else None)  # type: ignore[arg-type]
            counts = f" ({{n_fmt}} of {{total_fmt}} {unit}s)" if unit else ""
            fraction = f"{{percentage:.0f}} %{counts}, {{remaining}} left"
            line = fraction if total else f"{{n_fmt}} {unit}s in {{elapsed}}"
            title = ("{desc}: " if unit else "{desc}, ") if "desc" in options else ""
            options |= {"bar_format": f"roadtorch: {title}{line}", "leave": False, "miniters": 1}
            options |= {"mininterval": LINE_INTERVAL, "delay": LINE_INTERVAL}
        super().__init__(items, unit=unit, disable=quiet, file=sys.stderr, **options)

    def display(self, msg: str | None = None, pos: int | None = None) -> None:
        """Draw the bar, or write its line."""
        if not self._lines:
            super().display(msg, pos)
        elif msg is None:
            self.fp.write(f"{self}\n")
            self.fp.flush()

    def clear(self, nolock: bool = False) -> None:
        """Clear the bar to make room for a message; lines stay."""
        if not self._lines:
            super().clear(nolock)

    def refresh(self, nolock: bool = False, lock_args: Any = None) -> Any:
        """Draw the bar again; write a line only when it is due, not after each message."""
        if not (self._lines and nolock):
            return super().refresh(nolock, lock_args)
