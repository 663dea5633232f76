"""Results that several detectors need of one image, computed once.

Functions of an image (or of a result computed from one) and of settings are decorated with
``@cached_per_image``. Inside ``with image_cache():`` each computes once for an image and the same
settings; outside, it is a plain call. The result of one cached function may be the source of
another, so that a resized image, its superpixels and their statistics are all computed once.

Results are shared: nobody may change them in place.
"""

import time
from collections.abc import Callable, Hashable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from functools import wraps
from typing import Concatenate, NamedTuple, ParamSpec, TypeVar

_P = ParamSpec("_P")

_Source = TypeVar("_Source")

_Result = TypeVar("_Result")


class _CachedResult(NamedTuple):
    inputs: object  # kept alive, so that no other object can have the same id
    result: object
    seconds: float


@dataclass
class ImageCache:
    """Results computed so far, and the time in seconds that cached results saved."""

    saved_seconds: float = 0.0
    _results: dict[Hashable, _CachedResult] = field(default_factory=dict, repr=False)

    def get(self, key: Hashable, inputs: object, compute: Callable[[], _Result]) -> _Result:
        """Return the result for a key, computed if it is missing."""
        if key in self._results:
            cached = self._results[key]
            self.saved_seconds += cached.seconds
            return cached.result  # type: ignore[return-value]
        start, saved = time.perf_counter(), self.saved_seconds
        result = compute()
        # A later hit also saves the time that this computation itself saved by hits.
        seconds = time.perf_counter() - start + self.saved_seconds - saved
        self._results[key] = _CachedResult(inputs, result, seconds)
        return result


_current: ContextVar[ImageCache | None] = ContextVar("image_cache", default=None)


@contextmanager
def image_cache() -> Iterator[ImageCache]:
    """Cache the results of ``cached_per_image`` functions inside the block."""
    cache = ImageCache()
    token = _current.set(cache)
    try:
        yield cache
    finally:
        _current.reset(token)


def cached_per_image(
    function: Callable[Concatenate[_Source, _P], _Result],
) -> Callable[Concatenate[_Source, _P], _Result]:
    """Cache a function by the identity of its first argument and the hash of the others.

    Settings hash by value, tensors by identity.
    """

    @wraps(function)
    def wrapped(source: _Source, /, *args: _P.args, **kwargs: _P.kwargs) -> _Result:
        cache = _current.get()
        if cache is None:
            return function(source, *args, **kwargs)
        key = (function, id(source), args, tuple(sorted(kwargs.items())))
        inputs = (source, args, kwargs)
        return cache.get(key, inputs, lambda: function(source, *args, **kwargs))

    return wrapped
