"""Signals that meet foreign code: told as what they are, handled by whom they were before."""

import os
import signal
from collections.abc import Callable

import pytest

from roadtorch.errors import InputError
from roadtorch.signals import (
    Terminated,
    interruption_first,
    noted_signals,
    stop_on_signals,
    terminated_in_words,
)


def send(number: signal.Signals) -> None:
    os.kill(os.getpid(), number)


@pytest.mark.parametrize(
    ("number", "raised"), [(signal.SIGINT, KeyboardInterrupt), (signal.SIGTERM, Terminated)]
)
def test_what_a_library_makes_of_an_interruption_is_an_interruption(
    number: signal.Signals, raised: type[KeyboardInterrupt]
) -> None:
    def read() -> None:
        try:
            send(number)
        except KeyboardInterrupt:
            raise InputError("weights", "is damaged", "remove it") from None

    with pytest.raises(raised), terminated_in_words(), interruption_first():
        read()


def test_an_error_of_its_own_stays_what_it_is() -> None:
    with pytest.raises(InputError, match="is damaged"), interruption_first():
        raise InputError("weights", "is damaged", "remove it")


def test_a_signal_that_is_only_asked_about_is_not_noted() -> None:
    with stop_on_signals() as stop, noted_signals() as noted:
        send(signal.SIGINT)

    assert stop.asked
    assert not noted.asked


def test_handlers_come_back_but_for_those_that_the_block_set() -> None:
    def theirs(*_: object) -> None: ...

    before: Callable[..., object] | int | None = signal.getsignal(signal.SIGINT)
    try:
        with noted_signals():
            signal.signal(signal.SIGTERM, signal.SIG_IGN)
        assert signal.getsignal(signal.SIGINT) is before
        assert signal.getsignal(signal.SIGTERM) is signal.SIG_IGN
        with noted_signals():
            signal.signal(signal.SIGINT, theirs)
        assert signal.getsignal(signal.SIGINT) is theirs
    finally:
        signal.signal(signal.SIGINT, before)
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
