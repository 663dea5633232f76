"""Twins of steps: what a graph computes where Python branches on values, or takes NumPy or OpenCV.

A step is decorated with ``@has_twin``. Inside ``with use_twins(…):``, as while a graph is traced,
its twin is called instead; outside, the step itself.
"""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from functools import wraps
from typing import Any, ParamSpec, TypeVar

_P = ParamSpec("_P")

_Result = TypeVar("_Result")

Twins = Mapping[Callable[..., Any], Callable[..., Any]]
"""Twins by the decorated step; each takes its arguments."""

_current: ContextVar[Twins | None] = ContextVar("twins", default=None)


@contextmanager
def use_twins(twins: Twins) -> Iterator[None]:
    """Call the twins of steps inside the block."""
    token = _current.set(twins)
    try:
        yield
    finally:
        _current.reset(token)


def has_twin(step: Callable[_P, _Result]) -> Callable[_P, _Result]:
    """Decorate a step that has a twin."""

    @wraps(step)
    def chosen(*args: _P.args, **kwargs: _P.kwargs) -> _Result:
        twins = _current.get()
        return (step if twins is None else twins[chosen])(*args, **kwargs)

    return chosen
