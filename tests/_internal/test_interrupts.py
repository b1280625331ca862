"""Ctrl-C and SIGTERM are heard, once, also where Python drops them."""

import os
import signal
import subprocess
import sys

import pytest

from mapf_pz._internal.interrupts import interruptible, interrupts_deferred, unheard_by_children


def send(*numbers):
    """Send this process signals; their handlers are called between two of Python's instructions."""
    for number in numbers:
        os.kill(os.getpid(), number)
        for _ in range(1000):
            pass


class Fragile:
    """Is interrupted while it is deleted: Python writes so, and goes on."""

    def __del__(self):
        send(signal.SIGINT)


def test_an_interrupt_that_is_dropped_is_raised_by_the_check(monkeypatch):
    dropped = []
    monkeypatch.setattr(sys, "unraisablehook", dropped.append)
    with interruptible() as check:
        check()
        fragile = Fragile()
        del fragile
        assert [told.exc_type for told in dropped] == [KeyboardInterrupt]
        with pytest.raises(KeyboardInterrupt):
            check()


def convert_an_interrupt():
    """Do as Python does with an interrupt that C code has not handed on."""
    try:
        send(signal.SIGINT)
    except KeyboardInterrupt as error:
        raise SystemError("a function returned a result with an exception set") from error


def test_an_interrupt_that_is_converted_is_raised_at_the_end():
    with pytest.raises(KeyboardInterrupt) as caught, interruptible():
        convert_an_interrupt()
    assert isinstance(caught.value.__cause__, SystemError)


def test_errors_without_an_interrupt_are_raised_as_they_are():
    with pytest.raises(SystemError), interruptible():
        raise SystemError("a function returned a result with an exception set")


@pytest.mark.parametrize("sent", [signal.SIGTERM, signal.SIGINT])
def test_signals_interrupt_and_the_handlers_come_back(sent):
    before = signal.getsignal(sent)
    with pytest.raises(KeyboardInterrupt), interruptible():
        send(sent)
    assert signal.getsignal(sent) is before


def test_ignored_interrupts_stay_ignored():
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        with interruptible() as check:
            send(signal.SIGINT)
            check()
    finally:
        signal.signal(signal.SIGINT, before)


def test_a_deferred_interrupt_is_reported():
    reached = []

    def work():
        with interrupts_deferred() as interrupted:
            reached.append(interrupted())
            send(signal.SIGTERM)
            reached.append(interrupted())

    work()
    assert reached == [False, True]


def test_a_second_interrupt_is_immediate():
    with pytest.raises(KeyboardInterrupt), interrupts_deferred():
        send(signal.SIGINT, signal.SIGTERM)


def test_child_processes_ignore_blocked_signals():
    wait = [sys.executable, "-c", "import time; print('ready', flush=True); time.sleep(1); print('end')"]
    with unheard_by_children():
        child = subprocess.Popen(wait, stdout=subprocess.PIPE, text=True)
    assert child.stdout.readline() == "ready\n"
    child.send_signal(signal.SIGINT)
    assert child.communicate() == ("end\n", None)
