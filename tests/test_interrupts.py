"""Ctrl-C and SIGTERM are heard, once, also where Python drops them."""

import os
import signal
import sys

import pytest

from mapf_pz.interrupts import interruptible, interrupts_held


def send(number):
    """Send this process a signal; its handler is called between two of Python's instructions."""
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


@pytest.mark.parametrize("sent", [signal.SIGTERM, signal.SIGINT])
def test_signals_interrupt_and_the_handlers_come_back(sent):
    before = signal.getsignal(sent)
    with pytest.raises(KeyboardInterrupt), interruptible():
        send(sent)
    assert signal.getsignal(sent) is before


def test_who_ignores_ctrl_c_goes_on_ignoring_it():
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        with interruptible() as check:
            send(signal.SIGINT)
            check()
    finally:
        signal.signal(signal.SIGINT, before)


def test_an_interrupt_that_is_held_comes_afterwards():
    reached = []

    def wait():
        with interrupts_held():
            send(signal.SIGINT)
            reached.append("the end")

    with pytest.raises(KeyboardInterrupt):
        wait()
    assert reached
