"""Work that several detectors need on one image, done once while it is shared.

Functions of an image (or of what was made of one) and of settings are marked ``@cached_per_image``.
Inside ``with image_cache():`` each of them computes once for an image and the same settings,
whoever asks; outside, it is a plain call. What one shared function made of an image may go
into another, so that a resized image, its superpixels and what is measured on them are all
made once.

Results are handed to several owners: nobody may change them in place.
"""

import time
from collections.abc import Callable, Hashable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from functools import wraps
from typing import Concatenate, NamedTuple, ParamSpec, TypeVar

P = ParamSpec("P")

Source = TypeVar("Source")

Result = TypeVar("Result")


class _Made(NamedTuple):
    given: object  # kept, so that nothing else can have its identity
    result: object
    seconds: float


@dataclass
class ImageCache:
    """What has been made so far; ``saved`` is the time that asking again did not take."""

    saved: float = 0.0  # seconds
    _made: dict[Hashable, _Made] = field(default_factory=dict, repr=False)

    def get(self, key: Hashable, given: object, make: Callable[[], Result]) -> Result:
        """The result under that key, made now if it is not there."""
        if key in self._made:
            made = self._made[key]
            self.saved += made.seconds
            return made.result  # type: ignore[return-value]
        start, saved = time.perf_counter(), self.saved
        result = make()
        # What it took from others counts as its own: whoever saves this saves that too.
        seconds = time.perf_counter() - start + self.saved - saved
        self._made[key] = _Made(given, result, seconds)
        return result


_current: ContextVar[ImageCache | None] = ContextVar("shared", default=None)


@contextmanager
def image_cache() -> Iterator[ImageCache]:
    """Share work inside the block; everything made is forgotten at its end."""
    shared = ImageCache()
    token = _current.set(shared)
    try:
        yield shared
    finally:
        _current.reset(token)


def cached_per_image(
    function: Callable[Concatenate[Source, P], Result],
) -> Callable[Concatenate[Source, P], Result]:
    """Mark a function of one source, told by identity, and of what can be hashed.

    That is settings, and other tensors, which are told by identity as well.
    """

    @wraps(function)
    def wrapped(source: Source, /, *args: P.args, **kwargs: P.kwargs) -> Result:
        shared = _current.get()
        if shared is None:
            return function(source, *args, **kwargs)
        key = (function, id(source), args, tuple(sorted(kwargs.items())))
        given = (source, args, kwargs)
        return shared.get(key, given, lambda: function(source, *args, **kwargs))

    return wrapped
