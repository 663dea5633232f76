"""Signals inside foreign code are raised as signals, and handlers are restored."""

import os
import select
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from roadtorch.base.errors import InputError
from roadtorch.base.signals import (
    SigtermInterrupt,
    prefer_interruption,
    raise_on_sigterm,
    record_signals,
    stop_on_signals,
)


def send(number: signal.Signals) -> None:
    os.kill(os.getpid(), number)


@pytest.mark.parametrize(
    ("number", "raised"), [(signal.SIGINT, KeyboardInterrupt), (signal.SIGTERM, SigtermInterrupt)]
)
def test_an_interruption_stays_one(number: signal.Signals, raised: type[KeyboardInterrupt]) -> None:
    def read() -> None:
        try:
            send(number)
        except KeyboardInterrupt:
            raise InputError("weights", "is damaged", "remove it") from None

    with pytest.raises(raised), raise_on_sigterm(), prefer_interruption():
        read()


def test_a_signal_that_only_requests_a_stop_is_not_recorded() -> None:
    with stop_on_signals() as stop, record_signals() as recorded:
        send(signal.SIGINT)

    assert stop.requested
    assert not recorded.requested


PROCESSES = """
import multiprocessing, os, time
from roadtorch.base.signals import end_with_parent, block_sigint_in_children

def work():
    end_with_parent()
    print(os.getpid(), flush=True)
    time.sleep(600)

if __name__ == "__main__":
    with block_sigint_in_children():
        process = multiprocessing.get_context("spawn").Process(target=work)
        process.start()
    print(os.getpid(), flush=True)
    process.join()
"""


def test_processes_do_not_see_ctrl_c_and_end_with_their_parent(tmp_path: Path) -> None:
    (tmp_path / "start.py").write_text(PROCESSES)
    words = [sys.executable, "start.py"]

    with subprocess.Popen(words, cwd=tmp_path, stdout=subprocess.PIPE) as first:
        assert first.stdout is not None
        pids = {int(first.stdout.readline()), int(first.stdout.readline())}
        (started,) = pids - {first.pid}
        os.kill(started, signal.SIGINT)
        assert not select.select([first.stdout], [], [], 0.5)[0]
        assert first.poll() is None
        first.kill()
        assert first.communicate(timeout=300) == (b"", None)  # nobody has stdout open any more


def test_handlers_come_back_but_for_those_that_the_block_set() -> None:
    def theirs(*_: object) -> None: ...

    handler: Callable[..., object] | int | None = signal.getsignal(signal.SIGINT)
    try:
        with record_signals():
            signal.signal(signal.SIGTERM, signal.SIG_IGN)
        assert signal.getsignal(signal.SIGINT) is handler
        assert signal.getsignal(signal.SIGTERM) is signal.SIG_IGN
        with record_signals():
            signal.signal(signal.SIGINT, theirs)
        assert signal.getsignal(signal.SIGINT) is theirs
    finally:
        signal.signal(signal.SIGINT, handler)
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
