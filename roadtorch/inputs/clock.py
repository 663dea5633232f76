"""The time of frames, by stamps that may step, stand still or be missing."""

import warnings

MAX_LAG = 60.0
"""Seconds by which stamps may run ahead of the time of recording; ours: more is a clock that was
set, less an image that was sent late."""

STAMP_ROUNDING = 1e-6  # seconds by which sums of stamps may differ


class FrameClock:
    """Seconds since the start of a source, which never step back.

    Where stamps step back, time goes on from the frame before; where they return to the earlier
    clock, as after a single wrong stamp, it follows that again. The first step is reported.

    origin: name of the source in the warning. step: usual seconds between frames.
    """

    def __init__(self, origin: object, step: float = 0.0) -> None:
        self.step, self.stepped = step, False
        self._origin = origin
        self._last: float | None = None
        self._stamp = self._offset = self._earlier = 0.0

    def seconds(self, stamp: float | None, elapsed: float = 0.0) -> float:
        """Return the time of the next frame.

        Args:
            stamp: its time stamp in seconds, 0 at the start of the source; None without one.
            elapsed: seconds since the frame before by another clock, 0 without one; stamps that run
                ahead of it by more than ``MAX_LAG`` have stepped.
        """
        step = elapsed or self.step
        if self._last is None:
            self._last = max(stamp or 0.0, 0.0)
            self._offset = self._earlier = self._last - (stamp or 0.0)
        elif stamp is None or stamp == self._stamp:
            self._last += step
        else:
            times = stamp + self._earlier, stamp + self._offset
            latest = self._last + elapsed + MAX_LAG if elapsed else float("inf")
            going_on = [time for time in times if self._last - STAMP_ROUNDING <= time <= latest]
            if not going_on:
                if not self.stepped:
                    change, time = times[1] - self._last - step, self._last
                    problem = f"the clock steps by {change:+.1f} s at {time:.1f} s"
                    hint = "times go on from the frame before"
                    warnings.warn(f"{self._origin}: {problem} ({hint})", stacklevel=2)
                self.stepped = True
                self._earlier, self._offset = self._offset, self._last + step - stamp
            elif going_on[0] == times[0]:
                self._offset = self._earlier
            self._last = max(self._last, stamp + self._offset)
        self._stamp = self._stamp if stamp is None else stamp
        return self._last
